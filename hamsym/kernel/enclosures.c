/* Steps of an enclosure over one window; see enclosures.h. Matrices have their rows one after the other. */

#include "enclosures.h"
#include "functions.h"
#include <stdlib.h>

/* -- guesses, without bounds ------------------------------------------------------------------- */

/* Run a program on values at points, rows of n numbers, a multiple of eight. */
void run_values(const series_step *program, long steps, double *rows, long n) {
  typedef void row_function(const double *, double *, long);
  static row_function *const functions[] = {hamsym_log, hamsym_atan, hamsym_asin, hamsym_acos, hamsym_asinh,
                                            hamsym_acosh, hamsym_atanh, hamsym_erf};
  for (long step = 0; step < steps; step++, program++) {
    double *out = rows + program->out * n, *a = rows + program->first * n, *b = rows + program->second * n;
    switch (program->operation) {
      case SUM: for (long c = 0; c < n; c++) out[c] = a[c] + b[c]; break;
      case DIFFERENCE: for (long c = 0; c < n; c++) out[c] = a[c] - b[c]; break;
      case OPPOSITE: for (long c = 0; c < n; c++) out[c] = -a[c]; break;
      case PRODUCT: for (long c = 0; c < n; c++) out[c] = a[c] * b[c]; break;
      case INVERSE: for (long c = 0; c < n; c++) out[c] = 1 / a[c]; break;
      case INVERSE_ROOT: for (long c = 0; c < n; c++) out[c] = a[c] > 0 ? 1 / sqrt(a[c]) : NAN; break;
      case EXPONENTIAL: hamsym_exp(a, out, n); break;
      case SINE_COSINE: hamsym_sin_cos(a, out, b, n); break;
      case REDUCED_ANGLE: fill(out, NAN, n); break; /* it is part of what does not depend on the state */
      default: functions[program->operation - LOGARITHM](a, out, n);
    }
  }
}

EXPORTED void hamsym_run_values(const series_step *program, int64_t steps, double *rows, int64_t n) {
  run_values(program, steps, rows, n);
}

/* Fixed-point iteration for y at the points; the first rows begin with a guess. Returns the number of iterations, or
   0 where y is not finite. */
EXPORTED int64_t hamsym_collocate(const series_step *program, int64_t steps, const int64_t *results, double *rows,
                                  int64_t points, const double *integral, const double *start, int64_t dim,
                                  double half, int64_t most) {
  double *news = malloc(dim * points * sizeof *news), before = INFINITY;
  int slow = 0;
  int64_t count = news ? 1 : most + 1, found = news ? most : -1;
  for (; count <= most; count++) {
    run_values(program, steps, rows, points);
    double change = 0.0;
    for (long i = 0; i < dim; i++) {
      double size = fabs(start[i]), moved = 0.0, *own = news + i * points, *old = rows + i * points;
      apply_table(integral, rows + results[i] * points, points, points, own);
      for (long c = 0; c < points; c++) {
        own[c] = start[i] + half * own[c];
        moved = larger(fabs(own[c] - old[c]), moved);
        size = larger(fabs(own[c]), size);
      }
      if (size > 0) change = larger(moved / size, change);
      if (!(moved < INFINITY)) {
        free(news);
        return 0;
      }
    }
    memcpy(rows, news, dim * points * sizeof *news);
    if (change < 4e-16 || (change < 1e-13 && change >= 0.5 * before)) {
      found = count;
      break;
    }
    slow = change >= before ? slow + 1 : 0;
    if (slow > 12) break; /* round-off, or a guess that the tail or the defect of y will refuse */
    before = change;
  }
  free(news);
  return found;
}

/* c with c = -D + w int A c at the points, from -D; both are dim x points. The iteration ends when c has converged in
   units of the components. */
int iterate_correction(const double *rows, const entry *entries, const double *signs, long count, long dim,
                       const double *integral, long points, double half, const double *wanted, const double *units,
                       long most, double enough, double *found) {
  double *rates = malloc((dim + 1) * points * sizeof *rates);
  if (!rates) return 0;
  double *done = rates + dim * points;
  memcpy(found, wanted, dim * points * sizeof *found);
  while (most--) {
    memset(rates, 0, dim * points * sizeof *rates);
    for (long e = 0; e < count; e++) {
      long i = entries[e].i, j = entries[e].j;
      const double *a = rows + entries[e].place * points;
      if (j < dim)
        for (long x = 0; x < points; x++) rates[i * points + x] += signs[e] * a[x] * found[j * points + x];
    }
    double change = 0.0, size = 0.0;
    for (long i = 0; i < dim; i++) {
      double moved = 0.0, large = 0.0, *own = found + i * points;
      apply_table(integral, rates + i * points, points, points, done);
      for (long x = 0; x < points; x++) {
        double value = wanted[i * points + x] + half * done[x];
        moved = larger(fabs(value - own[x]), moved);
        large = larger(fabs(value), large);
        own[x] = value;
      }
      change = larger(moved / units[i], change);
      size = larger(large / units[i], size);
    }
    if (!(change < INFINITY) || change <= enough * size) break;
  }
  free(rates);
  return 1;
}

EXPORTED int64_t hamsym_correction(const double *rows, const entry *entries, const double *signs, int64_t count,
                                   int64_t dim, const double *integral, int64_t points, double half,
                                   const double *wanted, const double *units, int64_t most, double *found) {
  return iterate_correction(rows, entries, signs, count, dim, integral, points, half, wanted, units, most, 1e-14, found);
}

#define HALF (4 * UNIT) /* of the half length, whose low part is left out */
#define CIRCLES 64      /* roundings of a circle of Gershgorin beside those of its sums */

/* -- the lemma --------------------------------------------------------------------------------- */

/* Coefficients of D for each component, terms + 1, and bounds on |D|; the models hold y and constants. */
EXPORTED void hamsym_defects(const series_step *program, int64_t steps, const int64_t *results, const series_rows *rows,
                             int64_t dim, const ball *half, double *found, double *sizes) {
  long terms = rows->terms;
  double inner[terms + 1], inner_low[terms + 1], wide[terms + 2], rest[terms + 2];
  run_series(program, steps, rows, 1);
  memset(found, 0, dim * (terms + 1) * sizeof *found);
  for (long i = 0; i < dim; i++, found += terms + 1) {
    long r = results[i], n = rows->length[r], m = rows->length[i];
    const double *high = rows->high + r * terms, *low = rows->low + r * terms;
    const double *own = rows->high + i * terms, *own_low = rows->low + i * terms;
    double error = multiply_series(&half->high, &half->low, 1, high, low, n, inner, inner_low, 1);
    error += half->radius * norm_of(high, low, n) + rows->radius[r] * (fabs(half->high) * (1 + HALF));
    error = 2 * error + integrate_series(inner, inner_low, n, wide, rest, 1);
    ball begin = end_value(own, own_low, m, -1);
    double total = 0.0;
    for (long c = 0; c < (n + 1 > m ? n + 1 : m); c++) {
      double a = c < m ? own[c] : 0.0, x = c < m ? own_low[c] : 0.0;
      double b = c <= n ? -wide[c] : 0.0, y = c <= n ? -rest[c] : 0.0;
      pair sum = two_sum(a, b);
      total += MIDDLE * (fabs(a) + fabs(b));
      if (c == 0) {
        pair less = two_sum(sum.high, -begin.high);
        sum = (pair){less.high, (sum.low + less.low) - begin.low};
        total += begin.radius + MIDDLE * fabs(begin.high) * 2;
      }
      sum = two_sum(sum.high, sum.low + (x + y));
      found[c] = sum.high;
      total += fabs(sum.high) + fabs(sum.low);
    }
    sizes[i] = up(error + total);
  }
}

/* The 2-norm of a vector of numbers >= 0 in units, rounded up; its entries are `stride` numbers apart. */
static double length_in(const double *vector, long n, long stride, const double *units) {
  double total = 0.0;
  for (long i = 0; i < n; i++) {
    double value = up(vector[i * stride]) / units[i];
    total += value * value;
  }
  return up(sqrt(up(total)));
}

/* A bound on the largest eigenvalue of the symmetric part of U^-1 DG U, and 0, by Gershgorin's circles. */
static int logarithmic_norm(const lemma *s, double *norm) {
  long dim = s->dim, terms = s->terms;
  double *memory = calloc(dim * dim * (terms + 1), sizeof *memory), *apart = memory + dim * dim * terms;
  if (!memory) return 0;
  for (long e = 0; e < s->count; e++) {
    long i = s->entries[e].i, j = s->entries[e].j, n = s->jacobian_length[e];
    if (j >= dim) continue;
    const double *jacobian = s->jacobian + e * terms;
    double ratio = s->units[j] / s->units[i], *own = memory + (i * dim + j) * terms;
    for (long k = 0; k < n; k++) own[k] += s->signs[e] * jacobian[k] * ratio;
    apart[i * dim + j] += s->jacobian_radius[e] * (ratio + UNDERFLOW_ERROR);
    apart[i * dim + j] += UNDERFLOW_ERROR * (1 + norm_of(jacobian, 0, n));
  }
  *norm = 0.0;
  for (long i = 0; i < dim; i++) {
    const double *own = memory + (i * dim + i) * terms;
    double circle = own[0] + apart[i * dim + i], spread = fabs(own[0]);
    for (long k = 1; k < terms; k++) circle += fabs(own[k]);
    for (long j = 0; j < dim; j++) {
      if (j == i) continue;
      const double *one = memory + (i * dim + j) * terms, *other = memory + (j * dim + i) * terms;
      double total = apart[i * dim + j] + apart[j * dim + i];
      if (total == 0) continue; /* neither is an entry */
      for (long k = 0; k < terms; k++) {
        total += fabs(one[k] + other[k]);
        spread += fabs(one[k]) + fabs(other[k]);
      }
      circle += 0.5 * total;
    }
    circle = circle + (CIRCLES + 2 * (terms + dim)) * UNIT * (spread + fabs(circle));
    if (!(circle < INFINITY)) circle = INFINITY;
    *norm = greater(circle, *norm);
  }
  free(memory);
  return 1;
}

/* Bounds of the lemma: on |z - y| and |d - K xi|, dim, on |V_d - K|, dim x columns, and m. */
EXPORTED int64_t hamsym_lemma(const lemma *s, double *tube, double *d, double *derivative, double *norm) {
  long dim = s->dim, columns = s->columns, count = s->count;
  double *memory = calloc(2 * count + dim * columns + 3 * dim, sizeof *memory);
  if (!memory) return 0;
  double *large = memory, *loosely = large + count, *residual = loosely + count; /* |A_ij|, |B_ij|, |B V| + |A K| */
  double *begun = residual + dim * columns, *reach = begun + dim, *hidden = reach + dim;
  if (!logarithmic_norm(s, norm)) {
    free(memory);
    return 0;
  }
  for (long e = 0; e < count; e++) {
    long i = s->entries[e].i, j = s->entries[e].j;
    double size = norm_of(s->jacobian + e * s->terms, 0, s->jacobian_length[e]) + s->jacobian_radius[e];
    large[e] = s->half * size * (1 + GUARD) + UNDERFLOW_ERROR;
    loosely[e] = s->half * s->jacobian_radius[e] * (1 + GUARD) + UNDERFLOW_ERROR;
    double *own = residual + i * columns;
    if (j >= dim) own[j] += loosely[e];
    else
      for (long c = 0; c < columns; c++)
        own[c] += loosely[e] * s->sizes[j * columns + c] + large[e] * s->defect[j * columns + c];
  }
  for (long k = 0; k < dim * columns; k++) residual[k] = up(residual[k]);
  double growth = absolute(exponential(ball_of(up(2 * s->half * *norm))));
  for (long i = 0; i < dim; i++) {
    hidden[i] = UNDERFLOW_ERROR;
    for (long c = 0; c < columns; c++) {
      begun[i] += s->start_error[i * columns + c] * s->start[c];
      hidden[i] += s->defect[i * columns + c] * s->start[c];
    }
  }
  for (long e = 0; e < count; e++) {
    long i = s->entries[e].i, j = s->entries[e].j;
    if (j < dim) reach[i] += large[e] * (s->D[j] + hidden[j]) + loosely[e] * (s->hull[j] + UNDERFLOW_ERROR);
    else reach[i] += loosely[e] * s->start[j];
  }
  double bound = up(growth * (length_in(begun, dim, 1, s->units) + 2 * length_in(reach, dim, 1, s->units)));
  for (long i = 0; i < dim; i++) {
    d[i] = s->units[i] * bound;
    d[i] = up(d[i] + hidden[i]);
    tube[i] = up(s->hull[i] + s->D[i] + d[i]);
  }
  for (long c = 0; c < columns; c++) {
    double first = length_in(s->start_error + c, dim, columns, s->units);
    double rate = length_in(residual + c, dim, columns, s->units), most = up(growth * (first + 2 * rate));
    for (long i = 0; i < dim; i++)
      derivative[i * columns + c] = up(s->units[i] * most + s->defect[i * columns + c]);
  }
  free(memory);
  return 1;
}

/* Some rows of a product with TOGETHER columns, k x TOGETHER. */
INLINE void multiply_rows(const double *a, const double *columns, int height, long k, double *out, long stride) {
  int width = TOGETHER / LANES;
  vw sums[TOGETHER];
  add_up(columns, k, TOGETHER, a, height, width, sums);
  for (int j = 0; j < height * width; j++) store(out + j / width * stride + j % width * LANES, sums[j]);
}

/* The product of matrices, n x k and k x m; every sum has the same order everywhere. */
EXPORTED void hamsym_product(const double *a, const double *b, int64_t n, int64_t k, int64_t m, double *out) {
  double columns[(k + 1) * TOGETHER]; /* one after the other, where they stay in the cache */
  long c = 0;
  for (; c + TOGETHER <= m; c += TOGETHER) {
    for (long j = 0; j < k; j++) memcpy(columns + j * TOGETHER, b + j * m + c, TOGETHER * sizeof *b);
    long i = 0;
    for (; i + LANES <= n; i += LANES) multiply_rows(a + i * k, columns, LANES, k, out + i * m + c, m);
    for (; i < n; i++) multiply_rows(a + i * k, columns, 1, k, out + i * m + c, m);
  }
  for (long i = 0; i < n; i++)
    for (long d = c; d < m; d++) {
      double sum = 0.0;
      for (long j = 0; j < k; j++) sum += a[i * k + j] * b[j * m + d];
      out[i * m + d] = sum;
    }
}

/* Balance a matrix, dim x dim, of positive numbers beside its diagonal: in units of the components, sums of rows
   become those of columns (Osborne 1960). */
EXPORTED void hamsym_balance(const double *matrix, int64_t dim, double *units) {
  for (int sweep = 0; sweep < 6; sweep++)
    for (long i = 0; i < dim; i++) {
      double row = 0.0, column = 0.0;
      for (long j = 0; j < dim; j++) {
        row += matrix[i * dim + j] * units[j];
        column += matrix[j * dim + i] / units[j];
      }
      units[i] *= __builtin_sqrt(row / units[i] / (column * units[i]));
    }
}
