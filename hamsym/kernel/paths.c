/* Trial solutions of marches as functions of time: z_a + f(s) N(s) on each window, f(s) = 1 - exp(-s).

   The Chebyshev series of N in a window is that of the basis times the readout. It is made once for times that follow
   each other in the window, of which a block is evaluated at a time. A value is the same to the last bit whatever the
   other times are. */

#include "arena.h"
#include "functions.h"

#define BLOCK 32
#define CUT (EPS / 1024) /* a term that is left out, as a share of all, with the weight of a derivative */

/* Paths in consecutive rows: the edges and states of one begin at its first edge, its readouts at its first window. */
typedef struct {
  int64_t paths, columns, terms, dim;
  const int64_t *first_edge, *first_window, *windows;
  const double *edge, *state, *readout; /* readouts: windows x columns x dim */
  const double *series;                 /* columns x terms: of the basis, in 2 s - 1 */
} paths;

/* The last window that begins at or before a time, else the first one; the search begins at `near`. */
static long window_at(const double *edge, long windows, double t, long near) {
  double direction = edge[windows] > edge[0] ? 1.0 : -1.0;
  long low = 0, high = windows - 1;
  if (direction * t >= direction * edge[near]) low = near;
  if (low < high && !(direction * t >= direction * edge[low + 1])) return low;
  while (low < high) {
    long middle = (low + high + 1) / 2;
    if (direction * t >= direction * edge[middle]) low = middle;
    else high = middle - 1;
  }
  return low;
}

/* Chebyshev series of N, and after them, if they are asked for, of its derivative in s, in a window: rows of the terms
   in use, which are returned. `rows` has room for dim x columns numbers. */
static long window_series(const paths *p, const double *readout, int slopes, double *rows, double *series) {
  long terms = p->terms, dim = p->dim, used = 1;
  for (long m = 0; m < p->columns; m++)
    for (long i = 0; i < dim; i++) rows[i * p->columns + m] = readout[m * dim + i];
  products(p->series, p->columns, terms, rows, dim, series);
  for (long i = 0; i < dim; i++) {
    const double *own = series + i * terms;
    v4 sums = spread4(0.0);
    for (long k = 0; k < terms; k += 4) sums += size4(load4(own + k));
    double most = CUT * ((sums[0] + sums[1]) + (sums[2] + sums[3]));
    long last = terms;
    while (last > used && last * last * fabs(own[last - 1]) <= most) last--;
    used = last;
  }
  for (long i = 1; i < dim; i++) memmove(series + i * used, series + i * terms, used * sizeof *series);
  for (long i = 0; slopes && i < dim; i++) {
    const double *own = series + i * used;
    double *slope = series + (dim + i) * used;
    slope[used - 1] = 0.0;
    for (long k = used - 1; k > 0; k--) slope[k - 1] = 4 * k * own[k] + (k + 1 < used ? slope[k + 1] : 0.0);
    slope[0] /= 2;
  }
  return used;
}

/* States, paths x count x dim, at times that are counted as the edges, and their derivatives unless that is null.
   Returns 0 without memory. */
EXPORTED int64_t hamsym_paths(const paths *p, int64_t count, const double *times, double *states, double *rates) {
  long dim = p->dim, terms = p->terms;
  double *series, *rows, *found, *polynomials, *s, *x, *f;
  arena arena = {0};
  for (int turn = 0; turn < 2; turn++) { /* count, then lay out */
    series = take(&arena, 2 * dim * terms);
    rows = take(&arena, dim * p->columns);
    found = take(&arena, 2 * dim * BLOCK);
    polynomials = take(&arena, terms * BLOCK);
    s = take(&arena, BLOCK);
    x = take(&arena, BLOCK);
    f = take(&arena, BLOCK);
    if (!arena.memory && !allocate(&arena)) return 0;
  }
  for (long one = 0; one < p->paths; one++) {
    const double *edge = p->edge + p->first_edge[one], *state = p->state + p->first_edge[one] * dim;
    const double *readout = p->readout + p->first_window[one] * p->columns * dim;
    long window = 0, made = -1, used = 0, size, next;
    for (long first = 0; first < count; first += size, window = next) {
      next = window = window_at(edge, p->windows[one], times[first], window);
      double length = edge[window + 1] - edge[window];
      for (size = 0; size < BLOCK && first + size < count && next == window; size++) {
        s[size] = (times[first + size] - edge[window]) / length;
        if (first + size + 1 < count) next = window_at(edge, p->windows[one], times[first + size + 1], window);
      }
      for (long b = 0; b < BLOCK; b++) {
        if (b >= size) s[b] = s[0];
        x[b] = 2 * s[b] - 1, f[b] = -s[b];
      }
      hamsym_expm1(f, f, BLOCK);
      if (window != made) used = window_series(p, readout + window * p->columns * dim, rates != 0, rows, series);
      made = window;
      chebyshev_rows(x, used, BLOCK, polynomials);
      products(polynomials, used, BLOCK, series, rates ? 2 * dim : dim, found);
      for (long b = 0; b < size; b++)
        for (long i = 0; i < dim; i++) {
          double network = found[i * BLOCK + b], grown = -f[b];
          *states++ = state[window * dim + i] + grown * network;
          if (rates) *rates++ = ((1 - grown) * network + grown * found[(dim + i) * BLOCK + b]) / length;
        }
    }
  }
  free(arena.whole);
  return 1;
}
