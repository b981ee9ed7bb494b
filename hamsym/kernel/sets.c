/* Sets {G r} with |r| <= R between windows, and values of series. Matrices have their rows one after the other. */

#include "enclosures.h"
#include <stdlib.h>

#define PER_ENTRY 2                    /* roundings of an entry beside one for each product */
#define PER_LAYER (8 * UNIT * UNIT)    /* of a low part, for each pair of inputs */
#define MORE 8                         /* inputs that stand for what is done once */

/* a b, n x k and k x m, and a bound on its rounding errors, entry by entry. */
static void matrix_product(const double *a, const double *b, long n, long k, long m, double *found, double *error) {
  memset(found, 0, n * m * sizeof *found);
  memset(error, 0, n * m * sizeof *error);
  for (long i = 0; i < n; i++)
    for (long h = 0; h < k; h++) {
      double x = a[i * k + h];
      for (long j = 0; j < m; j++) {
        found[i * m + j] += x * b[h * m + j];
        error[i * m + j] += fabs(x) * fabs(b[h * m + j]);
      }
    }
  for (long place = 0; place < n * m; place++) error[place] = up((k + PER_ENTRY) * UNIT * error[place]);
}

/* J C rounded, n x columns, and bounds on the rest of (J +- J_error) C r with |r| <= r0, n x kinds; J is n x k. */
static int moved_set(const double *J, const double *J_error, const double *C, const double *r0, long n, long k,
                     long columns, long kinds, double *found, double *rest) {
  double *extent = calloc((k + 1) * kinds, sizeof *extent), *total = extent + k * kinds; /* |C| r0, and sums of r0 */
  if (!extent) return 0;
  hamsym_product(J, C, n, k, columns, found);
  for (long h = 0; h < k; h++)
    for (long c = 0; c < columns; c++)
      for (long kind = 0; kind < kinds; kind++) extent[h * kinds + kind] += fabs(C[h * columns + c]) * r0[c * kinds + kind];
  for (long c = 0; c < columns; c++)
    for (long kind = 0; kind < kinds; kind++) total[kind] += r0[c * kinds + kind];
  memset(rest, 0, n * kinds * sizeof *rest);
  for (long i = 0; i < n; i++)
    for (long h = 0; h < k; h++)
      for (long kind = 0; kind < kinds; kind++)
        rest[i * kinds + kind] +=
            ((k + PER_ENTRY) * UNIT * fabs(J[i * k + h]) + J_error[i * k + h]) * extent[h * kinds + kind];
  /* Products that underflow are below SMALL in an entry. */
  for (long place = 0; place < n * kinds; place++) rest[place] = up(rest[place] + SMALL * total[place % kinds]);
  free(extent);
  return 1;
}

EXPORTED int64_t hamsym_moved_set(const double *J, const double *J_error, const double *C, const double *r0, int64_t n,
                                  int64_t k, int64_t columns, int64_t kinds, double *found, double *rest) {
  return moved_set(J, J_error, C, r0, n, k, columns, kinds, found, rest);
}

/* Bounds on (value +- error) G r with |r| <= R, component by component, n x kinds. */
EXPORTED int64_t hamsym_set_radius(const double *value, const double *error, const double *G, const double *R,
                                   int64_t n, int64_t k, int64_t columns, int64_t kinds, double *found) {
  double *product = malloc(n * columns * sizeof *product);
  if (!product || !moved_set(value, error, G, R, n, k, columns, kinds, product, found)) {
    free(product);
    return 0;
  }
  for (long i = 0; i < n; i++)
    for (long kind = 0; kind < kinds; kind++) {
      double total = found[i * kinds + kind];
      for (long c = 0; c < columns; c++) total += fabs(product[i * columns + c]) * R[c * kinds + kind];
      found[i * kinds + kind] = up(total);
    }
  free(product);
  return 1;
}

/* |V G| R, without the roundings of its products, for each of dim rows of series, columns x terms; `turned` is G with
   rows and columns exchanged. */
EXPORTED int64_t hamsym_moved_sizes(const double *V, const double *turned, const double *R, int64_t dim, int64_t columns,
                                    int64_t terms, int64_t count, double *found) {
  double own[(columns + 1) * TOGETHER], *memory = malloc((count + 1) * (TOGETHER + 1) * sizeof *memory);
  if (!memory) return 0;
  double *sizes = memory + (count + 1) * TOGETHER;
  for (long i = 0; i < dim; i++, V += columns * terms) {
    memset(sizes, 0, count * sizeof *sizes);
    for (long k = 0; k < terms; k += TOGETHER) {
      long used = terms - k < TOGETHER ? terms - k : TOGETHER;
      for (long c = 0; c < columns; c++)
        for (long t = 0; t < TOGETHER; t++) own[c * TOGETHER + t] = t < used ? V[c * terms + k + t] : 0.0;
      hamsym_product(turned, own, count, columns, TOGETHER, memory);
      for (long r = 0; r < count * TOGETHER; r++) sizes[r / TOGETHER] += fabs(memory[r]);
    }
    found[i] = 0.0;
    for (long r = 0; r < count; r++) found[i] += sizes[r] * R[r];
  }
  free(memory);
  return 1;
}

/* Make columns orthogonal one after the other, twice; unit vectors where nothing is left. */
static void make_orthogonal(double *found, long n) {
  for (long c = 0; c < n; c++) {
    double length = 0.0;
    for (long attempt = 0; attempt <= n; attempt++) {
      double before = 0.0;
      for (long i = 0; i < n; i++) before += found[i * n + c] * found[i * n + c];
      for (int again = 0; again < 2; again++)
        for (long d = 0; d < c; d++) {
          double share = 0.0;
          for (long i = 0; i < n; i++) share += found[i * n + d] * found[i * n + c];
          for (long i = 0; i < n; i++) found[i * n + c] -= share * found[i * n + d];
        }
      length = 0.0;
      for (long i = 0; i < n; i++) length += found[i * n + c] * found[i * n + c];
      if (length > 1e-26 * before && length > 0) break;
      for (long i = 0; i < n; i++) found[i * n + c] = i == attempt;
    }
    length = sqrt(length);
    for (long i = 0; i < n; i++) found[i * n + c] /= length;
  }
}

/* Put the columns of `own`, n x count, with the longest parts of the set first into a square matrix. Kinds of sets may
   have different dimensions and are compared with the largest component of each. `lengths` has room for count numbers,
   `largest_of` for one of each kind. */
static void arrange(const double *own, const double *R, long n, long count, long kinds, double *lengths,
                    double *largest_of, double *arranged) {
  for (long kind = 0; kind < kinds; kind++) {
    largest_of[kind] = 0.0;
    for (long i = 0; i < n; i++) {
      double size = 0.0;
      for (long c = 0; c < count; c++) size += fabs(own[i * count + c]) * R[c * kinds + kind];
      largest_of[kind] = larger(size, largest_of[kind]);
    }
  }
  for (long c = 0; c < count; c++) {
    double longest = 0.0;
    lengths[c] = 0.0;
    for (long kind = 0; kind < kinds; kind++)
      if (R[c * kinds + kind] > 0) longest = larger(R[c * kinds + kind] / largest_of[kind], longest);
    for (long i = 0; i < n; i++) lengths[c] += (own[i * count + c] * longest) * (own[i * count + c] * longest);
  }
  for (long c = 0; c < n; c++) {
    long longest = 0;
    for (long d = 1; d < count; d++)
      if (lengths[d] > lengths[longest]) longest = d;
    lengths[longest] = -1.0;
    double largest = 0.0;
    for (long i = 0; i < n; i++) largest = larger(fabs(own[i * count + longest]), largest);
    /* A tiny column keeps its direction. */
    for (long i = 0; i < n; i++) arranged[i * n + c] = largest > 0 ? own[i * count + longest] / largest : 0.0;
  }
}

/* Sets {G r} with |r| <= R, G n x count and R count x kinds, as P r' in as many columns as rows: P and R'.

   Lemma 22. Q = U^-1 P is the orthogonal factor of the columns of U^-1 G ordered by the lengths of their parts of the
   set (Lohner 1992), with units U = diag(u), powers of two, because lengths and angles mean nothing between components
   of different dimensions. */
EXPORTED int64_t hamsym_boxed_set(const double *G, const double *R, const double *units, int64_t n, int64_t count,
                                  int64_t kinds, double *P, double *found) {
  double *own = calloc(3 * n * count + 4 * n * n + count + kinds, sizeof *own);
  if (!own) return 0;
  double *product = own + n * count, *error = product + n * count, *Q = error + n * count;
  double *inverse = Q + n * n, *unit = inverse + n * n, *unit_error = unit + n * n, *lengths = unit_error + n * n;
  /* U^-1 G; what underflows is below SMALL in a product. */
  for (long i = 0; i < n; i++)
    for (long c = 0; c < count; c++) own[i * count + c] = G[i * count + c] / units[i];
  arrange(own, R, n, count, kinds, lengths, lengths + count, Q);
  make_orthogonal(Q, n);
  for (long i = 0; i < n; i++)
    for (long c = 0; c < n; c++) {
      P[i * n + c] = Q[i * n + c] * units[i];
      Q[i * n + c] = P[i * n + c] / units[i]; /* so that P = U Q exactly, even if it underflowed */
      inverse[c * n + i] = Q[i * n + c];
    }
  matrix_product(inverse, Q, n, n, n, unit, unit_error);
  double f = 0.0;
  for (long i = 0; i < n; i++) {
    double row = 0.0;
    for (long c = 0; c < n; c++) row += fabs(unit[i * n + c] - (i == c)) + unit_error[i * n + c];
    f = greater(row < INFINITY ? up(row) : INFINITY, f);
  }
  matrix_product(inverse, own, n, n, count, product, error);
  for (long kind = 0; kind < kinds; kind++) {
    double largest = 0.0;
    for (long i = 0; i < n; i++) {
      double total = 0.0;
      for (long c = 0; c < count; c++)
        total += (fabs(product[i * count + c]) + error[i * count + c]) * R[c * kinds + kind];
      found[i * kinds + kind] = up(total);
      largest = larger(found[i * kinds + kind], largest);
    }
    for (long i = 0; i < n; i++)
      found[i * kinds + kind] = f < 0.5 ? up(found[i * kinds + kind] + f / (1 - f) * largest) : INFINITY;
  }
  free(own);
  return 1;
}

/* -- values ------------------------------------------------------------------------------------ */

/* T_0(x) .. T_terms-1(x). */
EXPORTED void hamsym_chebyshev_balls(const ball *x, int64_t terms, ball *out) {
  for (int64_t k = 0; k < terms; k++)
    out[k] = k == 0 ? ball_of(1.0) : k == 1 ? *x : subtract(scaled(multiply(*x, out[k - 1]), 2.0), out[k - 2]);
}

/* Values of series, rows x terms, and bounds on their errors. */
EXPORTED void hamsym_matrix_value(const double *series, const ball *basis, int64_t rows, int64_t terms, double *found,
                                  double *error) {
  for (long row = 0; row < rows; row++, series += terms) {
    double value = 0.0, total = 0.0;
    for (long k = terms - 1; k >= 0; k--) {
      double p = series[k] * basis[k].high, gap = fabs(basis[k].low) + basis[k].radius;
      value += p;
      total += UNIT * (fabs(p) + fabs(value)) + fabs(series[k]) * gap;
    }
    found[row] = value;
    error[row] = up(total);
  }
}

/* Values of series in twice float64, rows x terms, as balls. */
EXPORTED void hamsym_vector_value(const double *high, const double *low, const ball *basis, int64_t rows,
                                  int64_t terms, ball *found) {
  for (long row = 0; row < rows; row++) {
    ball total = ball_of(0.0);
    for (long k = terms - 1; k >= 0; k--)
      total = add(total, multiply((ball){high[row * terms + k], low[row * terms + k], 0.0}, basis[k]));
    found[row] = total;
  }
}

/* -- models of trial solutions ----------------------------------------------------------------- */

/* Models of weights @ f + bias, in twice float64. The sums of the errors of a product are those of series.h. */
EXPORTED void hamsym_dense(const double *weights, const double *bias, int64_t outputs, int64_t inputs,
                           const series_rows *f, const series_rows *out) {
  long terms = f->terms, count = 1;
  for (long j = 0; j < inputs; j++) count = f->length[j] > count ? f->length[j] : count;
  for (long i = 0; i < outputs; i++) {
    double *oh = out->high + i * terms, *ol = out->low + i * terms, error = 0.0;
    memset(oh, 0, terms * sizeof *oh);
    memset(ol, 0, terms * sizeof *ol);
    for (long j = 0; j < inputs; j++) {
      const double *high = f->high + j * terms, *low = f->low + j * terms, w = weights[i * inputs + j];
      double size = 0.0;
      for (long k = 0; k < f->length[j]; k++) {
        double p = w * high[k], e = fma(w, high[k], -p) + w * low[k];
        pair sum = two_sum(oh[k], p);
        ol[k] += sum.low + e;
        oh[k] = sum.high;
        size += fabs(high[k]) + fabs(low[k]);
      }
      /* Each low part is a sum of at most `inputs` errors. */
      error += fabs(w) * (f->radius[j] + (inputs + MORE) * (inputs + MORE) * PER_LAYER * size);
    }
    pair first = two_sum(oh[0], bias[i]);
    oh[0] = first.high;
    ol[0] += first.low;
    error += MIDDLE * (fabs(bias[i]) + fabs(first.high));
    for (long k = 0; k < count; k++) {
      pair sum = two_sum(oh[k], ol[k]);
      oh[k] = sum.high, ol[k] = sum.low;
    }
    out->radius[i] = up(error);
    out->length[i] = count;
  }
}

/* Models of sum_k c_k T_k(a + b x), |a| + |b| <= 1 up to rounding, for each column of c, count x columns. The error of
   one step of the recurrence reaches the result times at most its number, because |U_j| <= j + 1. */
EXPORTED void hamsym_clenshaw(const double *ch, const double *cl, int64_t count, int64_t columns, const ball *a,
                              const ball *b, const series_rows *out) {
  long terms = out->terms;
  const double line[2] = {2 * a->high, 2 * b->high}, line_low[2] = {2 * a->low, 2 * b->low};
  double loose = 2 * (a->radius + b->radius);
  double wide[terms + 1], rest[terms + 1], two[terms], two_low[terms];
  for (long i = 0; i < columns; i++) {
    double *one = out->high + i * terms, *one_low = out->low + i * terms, total = 0.0;
    memset(one, 0, terms * sizeof *one);
    memset(one_low, 0, terms * sizeof *one);
    memset(two, 0, sizeof two);
    memset(two_low, 0, sizeof two_low);
    long used = 1;
    for (long k = count - 1; k >= 0; k--) {
      /* b_k = c_k + 2 (a + b x) b_k+1 - b_k+2; at the end c_0 + (a + b x) b_1 - b_2 */
      double share = k > 0 ? 1.0 : 0.5, size = 0.0;
      double made = multiply_series(line, line_low, 2, one, one_low, used, wide, rest, 1);
      made += loose * norm_of(one, one_low, used);
      if (++used > terms) {
        used = terms;
        made += fabs(wide[terms]) + fabs(rest[terms]);
      }
      for (long c = 0; c < used; c++) {
        pair sum = two_sum(share * wide[c], -two[c]);
        double e = sum.low + (share * rest[c] - two_low[c]);
        size += fabs(wide[c]) + fabs(two[c]);
        two[c] = one[c], two_low[c] = one_low[c];
        sum = two_sum(sum.high, e);
        one[c] = sum.high, one_low[c] = sum.low;
      }
      pair first = two_sum(one[0], ch[k * columns + i]);
      pair sum = two_sum(first.high, first.low + (one_low[0] + cl[k * columns + i]));
      one[0] = sum.high, one_low[0] = sum.low;
      made += MIDDLE * (size + fabs(ch[k * columns + i]) + fabs(one[0]));
      total += (k + 1) * made;
    }
    out->length[i] = used;
    out->radius[i] = up(total);
  }
}

/* Add products of coefficients of Taylor models, terms x cells, to their places; a row that is zero adds nothing. */
EXPORTED void hamsym_add_products(double *restrict found, const double *restrict first, const double *restrict second,
                                  const int64_t *rows, const int64_t *others, const int64_t *targets, int64_t count,
                                  int64_t cells) {
  for (long begin = 0, end; begin < count; begin = end) {
    const double *a = first + rows[begin] * cells;
    int zero = 1;
    for (long cell = 0; cell < cells; cell++) zero &= a[cell] == 0;
    for (end = begin; end < count && rows[end] == rows[begin]; end++) {
      const double *b = second + others[end] * cells;
      double *out = found + targets[end] * cells;
      for (long cell = 0; cell < cells && !zero; cell++) out[cell] += a[cell] * b[cell];
    }
  }
}
