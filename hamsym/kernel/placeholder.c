__attribute__((visibility("default"))) double hamsym_sum(const double *values, int count) {
    double sum = 0.0;
    for (int k = 0; k < count; k++)
        sum += values[k];
    return sum;
}
