/* Elementary functions of rows of float64.
 *
 * Every function reads n numbers (n a positive multiple of 8) and writes n numbers; out may be an argument's row.
 * Each result depends on its own argument alone, and has the same bits (which NaN it is apart) on every processor and
 * with every compiler that computes IEEE +, -, *, / and sqrt, rounds to nearest, and neither fuses nor reorders
 * operations (-ffp-contract=off).
 */
#ifndef HAMSYM_FUNCTIONS_H
#define HAMSYM_FUNCTIONS_H

void hamsym_sin(const double *x, double *out, long n);
void hamsym_cos(const double *x, double *out, long n);
void hamsym_sin_cos(const double *x, double *sine, double *cosine, long n); /* the same numbers in half the time */
void hamsym_tan(const double *x, double *out, long n);
void hamsym_exp(const double *x, double *out, long n);
void hamsym_expm1(const double *x, double *out, long n);
void hamsym_log(const double *x, double *out, long n);
void hamsym_log1p(const double *x, double *out, long n);
void hamsym_asin(const double *x, double *out, long n);
void hamsym_acos(const double *x, double *out, long n);
void hamsym_atan(const double *x, double *out, long n);
void hamsym_sinh(const double *x, double *out, long n);
void hamsym_cosh(const double *x, double *out, long n);
void hamsym_tanh(const double *x, double *out, long n);
void hamsym_asinh(const double *x, double *out, long n);
void hamsym_acosh(const double *x, double *out, long n);
void hamsym_atanh(const double *x, double *out, long n);
void hamsym_erf(const double *x, double *out, long n);
void hamsym_erfc(const double *x, double *out, long n);
void hamsym_pow(const double *x, const double *y, double *out, long n);
void hamsym_atan2(const double *y, const double *x, double *out, long n); /* the angle of the point (x, y) */

/* A function of one number. */
static inline double value_at(void (*function)(const double *, double *, long), double x) {
    double row[8] = {x, x, x, x, x, x, x, x};
    function(row, row, 8);
    return row[0];
}

#endif
