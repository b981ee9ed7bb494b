/* Steps of an enclosure of the true solution over one window of time: lemmas 16 to 20 of
   examples/guide/how_proofs_work.md.

   The equation is dz/dx = w G(t, z, k) on -1 <= x <= 1, with the half length w of the window, time t = t_m + w x and
   constants k (parameters that are not known exactly). y(x) is a polynomial near the solution, V(x) one near its
   derivatives by the start and by k; both are guesses, found by collocation and by Taylor series without bounds. With
   the defects D of y and K of V, V(-1) = I + F, and an interval matrix A_0 + B around w DG over a tube,

       z = y + (V - K) xi - D + d,   d' = A d + (B V - A K) xi - A D,   d(-1) = -F xi. */

#ifndef HAMSYM_ENCLOSURES_H
#define HAMSYM_ENCLOSURES_H

#include "series.h"

#define TOGETHER 8 /* columns that are computed together, with bounds */

/* An entry (i, j) of a matrix, in a row of numbers. */
typedef struct { int64_t i, j, place; } entry;

/* A step of the lemma. */
typedef struct {
  int64_t dim, columns, terms, count;
  const double *jacobian, *jacobian_radius; /* models of the entries of DG by their place, over the tube */
  const int64_t *jacobian_length;
  const entry *entries;
  const double *signs;
  const double *start; /* bounds on |xi|, columns */
  const double *hull;  /* bounds on |V xi| over the window, dim */
  const double *V;     /* coefficients, dim x columns x terms */
  const double *sizes, *defect, *start_error; /* bounds on |V|, |K| and |F|, dim x columns */
  const double *D;     /* bounds on |D|, dim */
  double half;         /* an upper bound on w */
  const double *units; /* any numbers > 0: roundings of their ratios are among those of the products */
} lemma;

void run_values(const series_step *program, long steps, double *rows, long n);
int64_t hamsym_collocate(const series_step *program, int64_t steps, const int64_t *results, double *rows,
                         int64_t points, const double *integral, const double *start, int64_t dim, double half,
                         int64_t most);
/* Coefficients of V, dim x columns x points, from values of DG at the points. `steps` are tables from values at the
   points to Taylor series between one point and the next one, points x points x orders, and `series` is that to
   coefficients. Terms of V are left out that are smaller than `enough` in units of the components, and those of an
   entry of DG that are smaller than this share of it. */
int64_t hamsym_tangents(const double *rows, const entry *entries, const double *signs, int64_t count, int64_t dim,
                        int64_t columns, const double *steps, const double *series, int64_t points, int64_t orders,
                        double half, const double *units, double enough, double *found);
/* The iteration for a correction of y ends when it changes by less than `enough`. */
int iterate_correction(const double *rows, const entry *entries, const double *signs, long count, long dim,
                       const double *integral, long points, double half, const double *wanted, const double *units,
                       long most, double enough, double *found);
void hamsym_defects(const series_step *program, int64_t steps, const int64_t *results, const series_rows *rows,
                    int64_t dim, const ball *half, double *found, double *sizes);
int64_t hamsym_flow_defects(const lemma *s, double *defect, double *start_error);
int64_t hamsym_lemma(const lemma *s, double *tube, double *d, double *derivative, double *norm);
void hamsym_balance(const double *matrix, int64_t dim, double *units);
int64_t hamsym_moved_set(const double *J, const double *J_error, const double *C, const double *r0, int64_t n,
                         int64_t k, int64_t columns, int64_t kinds, double *found, double *rest);
void hamsym_product(const double *a, const double *b, int64_t n, int64_t k, int64_t m, double *out);
void hamsym_dense(const double *weights, const double *bias, int64_t outputs, int64_t inputs, const series_rows *f,
                  const series_rows *out);
int64_t hamsym_boxed_set(const double *G, const double *R, const double *units, int64_t n, int64_t count,
                         int64_t kinds, double *P, double *found);

#endif
