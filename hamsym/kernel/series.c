/* Chebyshev series with bounds; see series.h. */

#include "series.h"
#include "functions.h"

#define MOST (2 * MOST_TERMS + 2) /* terms of a product, and room */

/* -- series ------------------------------------------------------------------------------------ */

void apply_table(const double *table, const double *vector, long count, long n, double *out) {
  long k = 0;
  for (; k + 16 <= n; k += 16) {
    vw sums[16 / LANES];
    add_up(table + k, count, n, vector, 1, 16 / LANES, sums);
    memcpy(out + k, sums, sizeof sums);
  }
  for (; k + 8 <= n; k += 8) {
    vw sums[8 / LANES];
    add_up(table + k, count, n, vector, 1, 8 / LANES, sums);
    memcpy(out + k, sums, sizeof sums);
  }
  for (; k < n; k++) {
    double sum = 0.0;
    for (long j = 0; j < count; j++) sum += vector[j] * table[j * n + k];
    out[k] = sum;
  }
}

/* A bound on errors, infinite beside coefficients that are not finite. */
static double finished(const double *oh, const double *ol, long count, double error) {
  double total = 0.0;
  for (long k = 0; k < count; k++) total += fabs(oh[k]) + fabs(ol[k]);
  return total < INFINITY ? up(error) : INFINITY;
}

/* Add x b to a series. */
INLINE void add_times(double x, const double *restrict b, long n, double *restrict out) {
  for (long j = 0; j < n; j++) out[j] += x * b[j];
}

/* Add (x + y) (bh + bl) to a series, exactly but for the roundings of its low part. */
INLINE void add_product(double x, double y, const double *restrict bh, const double *restrict bl, long n,
                        double *restrict oh, double *restrict ol) {
  for (long j = 0; j < n; j++) {
    double p = x * bh[j], e = fma(x, bh[j], -p) + (x * bl[j] + y * bh[j]), s = oh[j] + p, t = s - oh[j];
    ol[j] += ((oh[j] - (s - t)) + (p - t)) + e;
    oh[j] = s;
  }
}

static void reverse(const double *b, long n, double *out) {
  for (long j = 0; j < n; j++) out[j] = b[n - 1 - j];
}

double multiply_series(const double *ah, const double *al, long na, const double *bh, const double *bl, long nb,
                       double *oh, double *ol, int twice) {
  long count = na + nb - 1;
  double size = 0.0, other = 0.0, back[nb], back_low[nb];
  memset(oh, 0, count * sizeof *oh);
  memset(ol, 0, count * sizeof *ol);
  for (long k = 0; k < nb; k++) other += fabs(bh[k]) + (bl ? fabs(bl[k]) : 0.0);
  reverse(bh, nb, back);
  if (!twice) {
    for (long i = na - 1; i >= 0; i--) {
      /* Terms b_j with j <= i go to i - j, the others to j - i. */
      long n = lesser(i + 1, nb), skipped = nb - n;
      double x = 0.5 * ah[i];
      size += (PER_PRODUCT + PER_SUM * (i + 1)) * fabs(ah[i]);
      if (x == 0) continue;
      add_times(x, bh, nb, oh + i);
      add_times(x, back + skipped, n, oh + i + 1 - n);
      if (skipped > 0) add_times(x, bh + n, skipped, oh + 1);
    }
    return finished(oh, ol, count, UNIT * size * other + HALVING * other);
  }
  reverse(bl, nb, back_low);
  for (long i = na - 1; i >= 0; i--) {
    long n = lesser(i + 1, nb), skipped = nb - n;
    double x = 0.5 * ah[i], y = 0.5 * al[i];
    size += (i + 1) * (i + 2) / 2 * (fabs(ah[i]) + fabs(al[i]));
    if (x == 0 && y == 0) continue;
    add_product(x, y, bh, bl, nb, oh + i, ol + i);
    add_product(x, y, back + skipped, back_low + skipped, n, oh + i + 1 - n, ol + i + 1 - n);
    if (skipped > 0) add_product(x, y, bh + n, bl + n, skipped, oh + 1, ol + 1);
  }
  for (long k = 0; k < count; k++) {
    pair sum = two_sum(oh[k], ol[k]);
    oh[k] = sum.high, ol[k] = sum.low;
  }
  return finished(oh, ol, count, PRODUCT_TWICE * size * other + HALVING * other);
}

/* The integral from -1, in count + 1 terms. */
double integrate_series(const double *ch, const double *cl, long count, double *oh, double *ol, int twice) {
  for (long k = count; k > 0; k--) {
    double h = ch[k - 1], m = cl ? cl[k - 1] : 0.0;
    if (k == 1) h *= 2, m *= 2;
    if (k + 1 < count) {
      pair first = two_sum(h, -ch[k + 1]), sum = two_sum(first.high, first.low + (m - (cl ? cl[k + 1] : 0.0)));
      h = sum.high, m = sum.low;
    }
    oh[k] = h / (2 * k);
    ol[k] = twice ? (fma(-oh[k], 2.0 * k, h) + m) / (2 * k) : 0.0;
  }
  pair value = {0.0, 0.0};
  for (long k = count; k > 0; k--) {
    double sign = k % 2 == 1 ? 1.0 : -1.0;
    pair sum = two_sum(value.high, sign * oh[k]);
    value = (pair){sum.high, value.low + (sum.low + sign * ol[k])};
  }
  value = two_sum(value.high, value.low);
  oh[0] = value.high;
  ol[0] = twice ? value.low : 0.0;
  return up((twice ? INTEGRAL_TWICE : INTEGRAL) * norm_of(ch, cl, count));
}

/* The derivative, in count - 1 terms, at least one; a bound on its rounding errors. */
static double differentiate_series(const double *ch, const double *cl, long count, double *oh, double *ol, int twice) {
  oh[0] = ol[0] = 0.0;
  double weight = 0.0;
  for (long k = count - 2; k >= 0; k--) {
    double factor = 2.0 * (k + 1), p = factor * ch[k + 1];
    double h = p, m = fma(factor, ch[k + 1], -p) + factor * cl[k + 1];
    if (k + 2 < count - 1) {
      pair first = two_sum(h, oh[k + 2]), sum = two_sum(first.high, first.low + (m + ol[k + 2]));
      h = sum.high, m = sum.low;
    }
    weight += (k / 2.0 + 1) * (fabs(h) + fabs(p));
    oh[k] = h;
    ol[k] = twice ? m : 0.0;
  }
  oh[0] *= 0.5;
  ol[0] *= 0.5;
  return up((twice ? DERIVATIVE_TWICE : DERIVATIVE) * weight);
}

ball end_value(const double *high, const double *low, long count, int end) {
  double value = 0.0, rest = 0.0, weight = 0.0, small = 0.0;
  for (long k = count - 1; k >= 0; k--) {
    double sign = end > 0 || k % 2 == 0 ? 1.0 : -1.0, l = low ? low[k] : 0.0;
    pair sum = two_sum(value, sign * high[k]);
    value = sum.high;
    rest += sum.low + sign * l;
    weight += (k + 1) * fabs(high[k]);
    small += (k + 1) * fabs(l);
  }
  pair sum = two_sum(value, rest);
  return (ball){sum.high, sum.low, up((count + AT_END) * UNIT * (UNIT * weight + small))};
}

/* The size of the terms beyond the rows. */
static double cut(const double *oh, const double *ol, long count, long terms) {
  double rest = 0.0;
  for (long k = terms; k < count; k++) rest += fabs(oh[k]) + fabs(ol[k]);
  return rest;
}

/* Remove the round-off behind the last significant term, so that it can be corrected. */
static void trim(double *vector, long count) {
  double largest = 0.0;
  for (long c = 0; c < count; c++) largest = larger(fabs(vector[c]), largest);
  for (long c = count - 1; c > 0 && fabs(vector[c]) <= 4e-15 * largest; c--) vector[c] = 0.0;
}

/* Add a correction of float64 to a series in twice float64. */
static void correct(double *high, double *low, long count, const double *change, double sign) {
  for (long c = 0; c < count; c++) {
    pair first = two_sum(high[c], sign * change[c]), sum = two_sum(first.high, first.low + low[c]);
    high[c] = sum.high, low[c] = sum.low;
  }
}

/* A function at rows of any length. */
static void at_points(void (*function)(const double *, double *, long), const double *x, double *out, long n) {
  double rest[8] = {0.0};
  long whole = n / 8 * 8;
  if (whole) function(x, out, whole);
  if (whole == n) return;
  memcpy(rest, x + whole, (n - whole) * sizeof *x);
  function(rest, rest, 8);
  memcpy(out + whole, rest, (n - whole) * sizeof *x);
}

/* -- models ------------------------------------------------------------------------------------ */

/* One model in its row. */
typedef struct {
  double *high, *low, *radius;
  int64_t *length;
} model;

static model at(const series_rows *rows, long k) {
  return (model){rows->high + k * rows->terms, rows->low + k * rows->terms, rows->radius + k, rows->length + k};
}

static double norm(model f) { return norm_of(f.high, f.low, *f.length); }

static void add_models(model a, model b, double sign, int twice, model out) {
  long n = *a.length, m = *b.length, count = n > m ? n : m;
  double total = 0.0;
  for (long c = 0; c < count; c++) {
    double x = c < n ? a.high[c] : 0.0, y = c < m ? sign * b.high[c] : 0.0;
    pair sum = two_sum(x, y);
    if (twice) {
      double low = (c < n ? a.low[c] : 0.0) + (c < m ? sign * b.low[c] : 0.0);
      total += (fabs(x) + fabs(y)) * MIDDLE;
      sum = two_sum(sum.high, sum.low + low);
    } else {
      total += fabs(sum.low);
      sum.low = 0.0;
    }
    out.high[c] = sum.high, out.low[c] = sum.low;
  }
  *out.radius = up(*a.radius + *b.radius + total);
  *out.length = count;
}

static void copy_model(model f, double sign, model out) {
  for (long c = 0; c < *f.length; c++) out.high[c] = sign * f.high[c], out.low[c] = sign * f.low[c];
  *out.length = *f.length, *out.radius = *f.radius;
}

/* f minus the multiple of 2 pi that brings its middle near zero. */
static void reduce_angle(model f, model out) {
  ball turn = scaled(HALF_PI, 4.0);
  double turns = f.high[0] / turn.high;
  copy_model(f, 1.0, out);
  if (!(fabs(turns) <= 0x1p50)) {
    *out.radius = INFINITY;
    return;
  }
  double count = floor(turns + 0.5);
  if (count == 0) return;
  ball middle = subtract((ball){f.high[0], f.low[0], *f.radius}, multiply(ball_of(count), turn));
  out.high[0] = middle.high, out.low[0] = middle.low, *out.radius = middle.radius;
}

static void multiply_models(model a, model b, long terms, int twice, model out) {
  long n = *a.length, m = *b.length, count = n + m - 1;
  double wide[count + 1], rest[count + 1], size = norm(a), other = norm(b), first = *a.radius, second = *b.radius;
  double error = multiply_series(a.high, a.low, n, b.high, b.low, m, wide, rest, twice);
  error += cut(wide, rest, count, terms);
  error += first * (other + second) + size * second;
  *out.length = lesser(count, terms);
  memcpy(out.high, wide, *out.length * sizeof *wide);
  memcpy(out.low, rest, *out.length * sizeof *rest);
  *out.radius = up(error);
}

/* Guess a function by its values at the points; the number of its terms is returned. */
static long guess(const series_rows *rows, const double *points, int constant, int twice, model out) {
  apply_table(rows->series, points, rows->terms, rows->terms, out.high);
  if (twice) trim(out.high, rows->terms);
  memset(out.low, 0, rows->terms * sizeof *out.low);
  return constant ? 1 : rows->terms;
}

/* 1/f */
static void invert(const series_rows *rows, model f, int twice, model out) {
  long terms = rows->terms, n = *f.length, rounds = twice ? 3 : 1;
  double points[terms], more[terms], wide[MOST], rest[MOST], other[MOST], other_low[MOST], error = 0.0;
  apply_table(rows->values, f.high, n, terms, points);
  for (long c = 0; c < terms; c++) points[c] = 1 / points[c];
  long count = guess(rows, points, n == 1, twice, out);
  for (long attempt = 0; attempt < rounds; attempt++) {
    error = multiply_series(f.high, f.low, n, out.high, out.low, count, wide, rest, twice);
    wide[0] -= 1;
    if (attempt == rounds - 1) break;
    for (long c = 0; c < terms; c++) more[c] = c < n + count - 1 ? wide[c] + rest[c] : 0.0;
    multiply_series(out.high, 0, count, more, 0, terms, other, other_low, 0);
    correct(out.high, out.low, count, other, -1.0);
  }
  error += cut(wide, rest, n + count - 1, 0);
  double size = norm_of(out.high, out.low, count);
  error = up(error + *f.radius * size);
  *out.radius = error < 0.5 ? up(size * error / (1 - error)) : INFINITY;
  *out.length = count;
}

/* 1/sqrt(f) */
static void invert_root(const series_rows *rows, model f, int twice, model out) {
  long terms = rows->terms, n = *f.length, rounds = twice ? 3 : 1, width = 0;
  double points[terms], more[terms], wide[MOST], rest[MOST], other[MOST], other_low[MOST], error = 0.0;
  apply_table(rows->values, f.high, n, terms, points);
  for (long c = 0; c < terms; c++) points[c] = points[c] > 0 ? 1 / sqrt(points[c]) : NAN;
  long count = guess(rows, points, n == 1, twice, out);
  for (long attempt = 0; attempt < rounds; attempt++) {
    /* f q first, with its own rounding and without a radius; then q (f q). */
    error = multiply_series(f.high, f.low, n, out.high, out.low, count, wide, rest, twice);
    error += cut(wide, rest, n + count - 1, terms);
    width = lesser(n + count - 1, terms);
    memcpy(other, wide, width * sizeof *wide);
    memcpy(other_low, rest, width * sizeof *rest);
    error = error * norm_of(out.high, out.low, count) +
            multiply_series(out.high, out.low, count, other, other_low, width, wide, rest, twice);
    wide[0] -= 1;
    if (attempt == rounds - 1) break;
    for (long c = 0; c < terms; c++) more[c] = c < width + count - 1 ? 0.5 * (wide[c] + rest[c]) : 0.0;
    multiply_series(out.high, 0, count, more, 0, terms, other, other_low, 0);
    correct(out.high, out.low, count, other, -1.0);
  }
  error += cut(wide, rest, width + count - 1, 0);
  double size = norm_of(out.high, out.low, count);
  error = up(error + *f.radius * size * size);
  int positive = least_of(end_value(out.high, out.low, count, 1)) > 0;
  *out.radius = error < 0.5 && positive ? up(size * error / (2 * (1 - error))) : INFINITY;
  *out.length = count;
}

/* The derivative of the polynomial of a model. */
typedef struct {
  double high[MOST], low[MOST], error, size;
  long length;
} slope;

static void set_slope(model f, int twice, slope *out) {
  out->length = *f.length > 1 ? *f.length - 1 : 1;
  out->error = differentiate_series(f.high, f.low, *f.length, out->high, out->low, twice);
  out->size = norm_of(out->high, out->low, out->length) + out->error;
}

/* s = q - q(-1) - sign integral(P' g) for series q and g of `count` terms, in `out`, and a bound on |s|. */
static double defect_of(const slope *rate, const double *qh, const double *ql, const double *gh, const double *gl,
                        long count, double sign, int constant, int twice, double *out, double *out_low, long *length) {
  double wide[MOST], rest[MOST];
  double error = multiply_series(rate->high, rate->low, rate->length, gh, gl, count, wide, rest, twice);
  error += rate->error * norm_of(gh, gl, count);
  long product = rate->length + count - 1;
  if (constant) wide[0] = rest[0] = 0.0;
  error = 2 * error + integrate_series(wide, rest, product, out, out_low, twice);
  for (long c = 0; c <= product; c++) {
    double o = sign * out[c], p = sign * out_low[c];
    pair sum = {-o, -p};
    if (c < count) {
      sum = two_sum(qh[c], -o);
      error += UNIT * (fabs(sum.low) + fabs(ql[c]) + fabs(p)) * 3;
      sum = two_sum(sum.high, sum.low + (ql[c] - p));
    }
    out[c] = sum.high, out_low[c] = sum.low;
  }
  ball behind = end_value(out, out_low, product + 1, -1);
  pair first = two_sum(out[0] - behind.high, out_low[0] - behind.low);
  out[0] = first.high, out_low[0] = first.low;
  error += behind.radius + UNIT * (fabs(out[0]) + fabs(behind.high)) * (twice ? 8 * UNIT : 2);
  *length = product + 1;
  return error + norm_of(out, out_low, product + 1);
}

/* Values at the points of the integral from -1 of a function given by its values there. */
static void integral_at_points(const series_rows *rows, const double *values, double *out) {
  long terms = rows->terms;
  double inner[terms], wide[MOST], rest[MOST];
  apply_table(rows->series, values, terms, terms, inner);
  integrate_series(inner, 0, terms - 1, wide, rest, 0);
  apply_table(rows->values, wide, terms, terms, out);
}

/* exp(f) */
static void exponential_model(const series_rows *rows, model f, int twice, model out) {
  long terms = rows->terms, n = *f.length, rounds = twice ? 3 : 1, length;
  double points[terms], more[terms], corrected[terms], inner[terms], other[MOST], other_low[MOST], defect = 0.0;
  slope rate;
  set_slope(f, twice, &rate);
  apply_table(rows->values, f.high, n, terms, points);
  at_points(hamsym_exp, points, points, terms);
  double spread = up(2 * (norm(f) - fabs(f.high[0]) * (1 - GUARD))), radius = *f.radius;
  ball head = exponential(end_value(f.high, f.low, n, -1)), apart = head;
  double grown = absolute(exponential(ball_of(spread < 1e6 ? spread : 1e6)));
  long count = guess(rows, points, n == 1, twice, out);
  for (long attempt = 0; attempt < rounds; attempt++) {
    defect = defect_of(&rate, out.high, out.low, out.high, out.low, count, 1.0, n == 1, twice, other, other_low, &length);
    ball begin = end_value(out.high, out.low, count, -1);
    apart = subtract(head, begin);
    if (attempt == rounds - 1) break;
    /* d = -s + q (d(-1)/q(-1) - integral(P' s / q)) at the points */
    apply_table(rows->values, other, lesser(length, terms), terms, points);
    apply_table(rows->values, rate.high, rate.length, terms, more);
    apply_table(rows->values, out.high, count, terms, corrected);
    for (long c = 0; c < terms; c++) more[c] = more[c] * points[c] / corrected[c];
    integral_at_points(rows, more, more);
    double first = (apart.high + apart.low) / begin.high;
    for (long c = 0; c < terms; c++) points[c] = corrected[c] * (first - more[c]) - points[c];
    apply_table(rows->series, points, terms, terms, inner);
    correct(out.high, out.low, count, inner, 1.0);
  }
  defect = up(defect);
  double error = up(defect + grown * (absolute(apart) + 2 * rate.size * defect));
  double size = norm_of(out.high, out.low, count) + error;
  error = radius <= 1 ? error + size * radius * 2 : INFINITY;
  *out.radius = up(error), *out.length = count;
}

/* sin(f) and cos(f), in two rows. */
static void sine_cosine_models(const series_rows *rows, model f, int twice, model sine, model cosine) {
  long terms = rows->terms, n = *f.length, rounds = twice ? 3 : 1, length;
  double s[terms], c[terms], ds[terms], dc[terms], one[terms], two[terms], steep[terms];
  double other[2][MOST], other_low[MOST], defects[2] = {0.0, 0.0}, radius = *f.radius;
  slope rate;
  set_slope(f, twice, &rate);
  apply_table(rows->values, f.high, n, terms, one);
  at_points(hamsym_sin, one, s, terms);
  at_points(hamsym_cos, one, c, terms);
  ball heads[2], apart[2];
  sine_cosine(end_value(f.high, f.low, n, -1), heads, heads + 1);
  model parts[2] = {sine, cosine};
  long count = guess(rows, s, n == 1, twice, sine);
  guess(rows, c, n == 1, twice, cosine);
  for (long attempt = 0; attempt < rounds; attempt++) {
    for (int part = 0; part < 2; part++) {
      model own = parts[part], beside = parts[1 - part];
      defects[part] = defect_of(&rate, own.high, own.low, beside.high, beside.low, count, part ? -1.0 : 1.0, n == 1,
                                twice, other[part], other_low, &length);
      apart[part] = subtract(heads[part], end_value(own.high, own.low, count, -1));
    }
    if (attempt == rounds - 1) break;
    /* In the rotating frame: (d + s) = M k, M = [[c, s], [-s, c]], k' = -P' M^T (s_c, -s_s). */
    apply_table(rows->values, sine.high, count, terms, s);
    apply_table(rows->values, cosine.high, count, terms, c);
    apply_table(rows->values, other[0], lesser(length, terms), terms, ds);
    apply_table(rows->values, other[1], lesser(length, terms), terms, dc);
    apply_table(rows->values, rate.high, rate.length, terms, steep);
    for (long k = 0; k < terms; k++) {
      /* v_s' = P' (v_c - s_c), v_c' = -P' (v_s - s_s) */
      double a = -steep[k] * dc[k], b = steep[k] * ds[k];
      one[k] = c[k] * a - s[k] * b;
      two[k] = s[k] * a + c[k] * b;
    }
    integral_at_points(rows, one, one);
    integral_at_points(rows, two, two);
    double first = apart[0].high + apart[0].low, second = apart[1].high + apart[1].low;
    double a0 = heads[1].high * first - heads[0].high * second, b0 = heads[0].high * first + heads[1].high * second;
    for (long k = 0; k < terms; k++) {
      double a = one[k] + a0, b = two[k] + b0;
      one[k] = c[k] * a + s[k] * b - ds[k];
      two[k] = -s[k] * a + c[k] * b - dc[k];
    }
    apply_table(rows->series, one, terms, terms, steep);
    correct(sine.high, sine.low, count, steep, 1.0);
    apply_table(rows->series, two, terms, terms, steep);
    correct(cosine.high, cosine.low, count, steep, 1.0);
  }
  double distance = up(absolute(apart[0]) + absolute(apart[1])), defect = up(defects[0] + defects[1]);
  double error = up(defect + distance + 2 * rate.size * defect + radius);
  *sine.radius = *cosine.radius = error, *sine.length = *cosine.length = count;
}

/* A function with f' = g(P) P' and a known value, from the model of g. */
static void integrate_model(enum series_operation operation, model f, model g, long terms, int twice, model out) {
  static ball (*const function[])(ball) = {logarithm, arctangent, arcsine, arccosine, inverse_hyperbolic_sine,
                                           inverse_hyperbolic_cosine, inverse_hyperbolic_tangent, error_function};
  long m = *g.length;
  double wide[MOST], rest[MOST], other[MOST], other_low[MOST];
  slope rate;
  set_slope(f, twice, &rate);
  double error = multiply_series(g.high, g.low, m, rate.high, rate.low, rate.length, wide, rest, twice);
  double size = norm(g) + *g.radius;
  error += rate.error * size + *g.radius * norm_of(rate.high, rate.low, rate.length);
  long product = m + rate.length - 1;
  error = 2 * error + integrate_series(wide, rest, product, other, other_low, twice);
  ball head = function[operation - LOGARITHM](end_value(f.high, f.low, *f.length, -1));
  ball total = add((ball){other[0], other_low[0], 0.0}, head);
  other[0] = total.high;
  other_low[0] = twice ? total.low : 0.0;
  if (!twice) error += fabs(total.low);
  error += total.radius + cut(other, other_low, product + 1, terms) + *f.radius * size;
  *out.length = lesser(product + 1, terms);
  memcpy(out.high, other, *out.length * sizeof *other);
  memcpy(out.low, other_low, *out.length * sizeof *other_low);
  *out.radius = up(error);
}

void run_series(const series_step *program, long steps, const series_rows *rows, int twice) {
  for (long step = 0; step < steps; step++, program++) {
    enum series_operation operation = program->operation;
    model out = at(rows, program->out), a = at(rows, program->first), b = at(rows, program->second);
    switch (operation) {
      case SUM: add_models(a, b, 1.0, twice, out); break;
      case DIFFERENCE: add_models(a, b, -1.0, twice, out); break;
      case OPPOSITE: copy_model(a, -1.0, out); break;
      case PRODUCT: multiply_models(a, b, rows->terms, twice, out); break;
      case REDUCED_ANGLE: reduce_angle(a, out); break;
      case INVERSE: invert(rows, a, twice, out); break;
      case INVERSE_ROOT: invert_root(rows, a, twice, out); break;
      case EXPONENTIAL: exponential_model(rows, a, twice, out); break;
      case SINE_COSINE:
        sine_cosine_models(rows, a, twice, out, b);
        if (!(*b.radius < INFINITY)) *b.radius = INFINITY;
        break;
      default: integrate_model(operation, a, b, rows->terms, twice, out);
    }
    if (!(*out.radius < INFINITY)) *out.radius = INFINITY;
  }
}

/* -- for Python -------------------------------------------------------------------------------- */

EXPORTED void hamsym_norms(const double *high, const double *low, int64_t rows, int64_t terms, double *out) {
  for (int64_t k = 0; k < rows; k++) out[k] = norm_of(high + k * terms, low ? low + k * terms : 0, terms);
}

EXPORTED double hamsym_multiply_series(const double *ah, const double *al, int64_t na, const double *bh,
                                       const double *bl, int64_t nb, double *oh, double *ol, int64_t twice) {
  return multiply_series(ah, al, na, bh, bl, nb, oh, ol, twice);
}

EXPORTED double hamsym_integrate_series(const double *ch, const double *cl, int64_t count, double *oh, double *ol,
                                        int64_t twice) {
  return integrate_series(ch, cl, count, oh, ol, twice);
}

EXPORTED double hamsym_differentiate_series(const double *ch, const double *cl, int64_t count, double *oh, double *ol,
                                            int64_t twice) {
  return differentiate_series(ch, cl, count, oh, ol, twice);
}

EXPORTED void hamsym_end_values(const double *high, const double *low, int64_t rows, int64_t stride, int64_t count,
                                int64_t end, ball *out) {
  for (int64_t k = 0; k < rows; k++)
    out[k] = end_value(high + k * stride, low ? low + k * stride : 0, count, (int)end);
}

EXPORTED void hamsym_run_series(const series_step *program, int64_t steps, const series_rows *rows, int64_t twice) {
  run_series(program, steps, rows, twice);
}
