/* The defects of V, some columns at a time; see enclosures.h. Rows hold one term of TOGETHER series. */

#include "enclosures.h"
#include <stdlib.h>

#define TILE 4 /* terms of a product that are computed together */

/* Add factor a b to sums, and the roundings to errors, with LANES columns in a vector. `wide` is b with terms b_-k = b_k,
   b_0 doubled and zeros behind its end. Each product is rounded by at most UNIT times what is returned and HALVING,
   times the size of b, before the factor. */
INLINE double add_product(double factor, const double *a, long na, const double *wide, long nb, int vectors,
                          double *sums, double *errors) {
  double size = 0.0;
  for (long i = 0; i < na; i++) size += (PER_PRODUCT + PER_SUM * (i + 1)) * fabs(a[i]);
  for (long m = 0; m < na + nb - 1; m += TILE) {
    vw found[TILE * TOGETHER / LANES];
    for (int t = 0; t < TILE * vectors; t++) found[t] = (vw){0.0};
    /* There are terms b_m-i from i = last on, and terms b_m+i below i = both. */
    long last = m < nb ? 0 : m - nb + 1, both = nb - m < na ? nb - m : na, i = na - 1;
    for (; i >= last && i >= both; i--)
      for (int t = 0; t < TILE * vectors; t++)
        found[t] += 0.5 * a[i] * load(wide + (m + t / vectors - i) * TOGETHER + t % vectors * LANES);
    for (; i >= last; i--)
      for (int t = 0; t < TILE * vectors; t++) {
        const double *behind = wide + (m + t / vectors) * TOGETHER + t % vectors * LANES;
        found[t] += 0.5 * a[i] * (load(behind - i * TOGETHER) + load(behind + i * TOGETHER));
      }
    for (int v = 0; v < vectors && m == 0; v++) found[v] *= 0.5;
    for (int t = 0; t < TILE * vectors; t++) {
      double *sum = sums + (m + t / vectors) * TOGETHER + t % vectors * LANES, *error = errors + t % vectors * LANES;
      vw p = factor * found[t], total = load(sum) + p;
      store(sum, total);
      store(error, load(error) + UNIT * (magnitudes(p) + magnitudes(total)));
    }
  }
  return size;
}

/* Bounds on the defect V - V(-1) - integral of series of `width` terms, whose errors are given, and on V(-1) - I; `one`
   has the 1 of I. Ends and integrals are those of end_value and integrate_series. */
static void bound_columns(const double *V, long terms, const double *series, long width, const double *errors,
                          const double *one, double *defect, double *start_error) {
  double begin[TOGETHER] = {0.0}, rest[TOGETHER] = {0.0}, weight[TOGETHER] = {0.0}, error[TOGETHER] = {0.0};
  double first[TOGETHER] = {0.0}, first_rest[TOGETHER] = {0.0}, size[TOGETHER] = {0.0};
  for (long k = terms - 1; k >= 0; k--)
    for (int c = 0; c < TOGETHER; c++) {
      double value = V[k * TOGETHER + c];
      pair sum = two_sum(begin[c], k % 2 == 0 ? value : -value);
      begin[c] = sum.high;
      rest[c] += sum.low;
      weight[c] += (k + 1) * fabs(value);
    }
  for (long k = width; k > 0; k--)
    for (int c = 0; c < TOGETHER; c++) {
      double before = series[(k - 1) * TOGETHER + c], behind = k + 1 < width ? series[(k + 1) * TOGETHER + c] : 0.0;
      double own = ((k == 1 ? 2 * before : before) - behind) / (2.0 * k);
      double left = (k < terms ? V[k * TOGETHER + c] : 0.0) - own;
      pair sum = two_sum(first[c], k % 2 == 1 ? own : -own);
      first[c] = sum.high;
      first_rest[c] += sum.low;
      error[c] += UNIT * fabs(left) + fabs(left);
      size[c] += fabs(before);
    }
  for (int c = 0; c < TOGETHER; c++) {
    pair sum = two_sum(begin[c], rest[c]);
    double radius = up((terms + AT_END) * UNIT * (UNIT * weight[c]));
    double left = V[c] - (first[c] + first_rest[c]), less = left - sum.high;
    start_error[c] = up(fabs(sum.high - one[c]) + fabs(sum.low) + radius);
    error[c] += UNIT * (fabs(left) + fabs(less)) + fabs(less) + 2 * errors[c] + radius + fabs(sum.low);
    error[c] += up(INTEGRAL * (size[c] * (1 + 2 * (width * UNIT + GUARD))));
    defect[c] = error[c] < INFINITY ? up(error[c]) : INFINITY;
  }
}

/* Bounds on the defect K of V and on F = V(-1) - I, dim x columns each. */
EXPORTED int64_t hamsym_flow_defects(const lemma *s, double *defect, double *start_error) {
  long dim = s->dim, columns = s->columns, terms = s->terms, count = s->count, width = 2 * terms + 1;
  long each = terms * TOGETHER, rows = dim * terms + 2 * terms + TILE + width + TILE + 4;
  double *V = calloc(rows * TOGETHER, sizeof *V);
  int64_t *order = calloc(count + dim + 1, sizeof *order), *end = order + count; /* entries by their rows */
  if (!V || !order) {
    free(V), free(order);
    return 0;
  }
  double *wide = V + (dim + 1) * each, *sums = wide + each + TILE * TOGETHER, *errors = sums + (width + TILE) * TOGETHER;
  double *one = errors + TOGETHER, *found = one + TOGETHER;
  for (long e = 0; e < count; e++) end[s->entries[e].i + 1]++;
  for (long i = 0; i < dim; i++) end[i + 1] += end[i];
  for (long e = 0; e < count; e++) order[end[s->entries[e].i]++] = e;
  for (long begin = 0; begin < columns; begin += TOGETHER) {
    long used = columns - begin < TOGETHER ? columns - begin : TOGETHER;
    for (long j = 0; j < dim; j++)
      for (long c = 0; c < used; c++)
        for (long k = 0; k < terms; k++) V[j * each + k * TOGETHER + c] = s->V[(j * columns + begin + c) * terms + k];
    for (long i = 0; i < dim; i++) {
      memset(sums, 0, (width + TILE + 1) * TOGETHER * sizeof *sums); /* and errors */
      for (long place = i ? end[i - 1] : 0; place < end[i]; place++) {
        long e = order[place], j = s->entries[e].j, n = s->jacobian_length[e];
        const double *a = s->jacobian + e * terms;
        double factor = s->signs[e] * s->half;
        if (j >= dim) { /* a rate by a constant, which moves its own column alone */
          for (long k = 0; k < n && j >= begin && j < begin + TOGETHER; k++) {
            double p = factor * a[k], *own = sums + k * TOGETHER + j - begin;
            *own += p;
            errors[j - begin] += UNIT * (fabs(p) + fabs(*own));
          }
          continue;
        }
        for (long k = 0; k < terms; k++) {
          const double *term = V + j * each + k * TOGETHER;
          memcpy(wide + k * TOGETHER, term, TOGETHER * sizeof *term);
          memcpy(wide - k * TOGETHER, term, TOGETHER * sizeof *term);
        }
        for (int c = 0; c < TOGETHER; c++) wide[c] *= 2;
        double size = used > LANES ? add_product(factor, a, n, wide, terms, TOGETHER / LANES, sums, errors)
                                   : add_product(factor, a, n, wide, terms, 1, sums, errors);
        for (long c = 0; c < used; c++) {
          double other = s->sizes[j * columns + begin + c];
          errors[c] += (1 + GUARD) * s->half * up(UNIT * size * other + HALVING * other);
        }
      }
      for (long c = 0; c < TOGETHER; c++) one[c] = i == begin + c;
      bound_columns(V + i * each, terms, sums, width, errors, one, found, found + TOGETHER);
      memcpy(defect + i * columns + begin, found, used * sizeof *found);
      memcpy(start_error + i * columns + begin, found + TOGETHER, used * sizeof *found);
    }
  }
  free(V), free(order);
  return 1;
}
