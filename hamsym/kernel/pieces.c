/* Pieces of flow maps: sum_r W_r(y) phi_r(t), with Chebyshev series W_r of the inputs and phi_r of the time.

   Queries are taken in blocks, so that the innermost loops run over the queries of a block. A value is the same
   to the last bit whatever the other queries are. */

#include "rows.h"
#include <stdlib.h>

#define BLOCK 24

/* Multi-indices count x inputs; readouts rank x count; columns (rank dim) x terms, by r, then by component. */
typedef struct {
  int64_t count, inputs, rank, terms, dim;
  const int64_t *degree;
  const double *readout, *column;
} piece;

/* Derivatives of the Chebyshev polynomials, from a table of these. */
static void slopes(const double *x, const double *table, long terms, double *out) {
  for (long n = 0; n < terms; n++, table += BLOCK, out += BLOCK)
    for (int b = 0; b < BLOCK; b++)
      out[b] = n < 2 ? n : 2 * (table[b - BLOCK] + x[b] * out[b - BLOCK]) - out[b - 2 * BLOCK];
}

/* Values at scaled times (queries) and inputs (queries x inputs), out queries x dim; derivatives in the input
   `slope` unless it is -1, and in the time if `rate`. Returns 0 without memory. */
EXPORTED int64_t hamsym_piece(const piece *p, int64_t queries, const double *times, const double *y, int64_t slope,
                              int64_t rate, double *out) {
  long most = p->terms;
  for (long k = 0; k < p->count * p->inputs; k++) most = p->degree[k] >= most ? p->degree[k] + 1 : most;
  long rows = (p->inputs + 1) * most + p->count + p->rank + p->rank * p->dim;
  double *tables = malloc(rows * BLOCK * sizeof(double)), place[BLOCK] = {0};
  if (!tables) return 0;
  double *other = tables + p->inputs * most * BLOCK, *terms = other + most * BLOCK;
  double *sums = terms + p->count * BLOCK, *parts = sums + p->rank * BLOCK;
  for (long first = 0; first < queries; first += BLOCK) {
    long size = queries - first < BLOCK ? queries - first : BLOCK;
    for (long k = 0; k < p->inputs; k++) {
      double *table = tables + k * most * BLOCK;
      for (long b = 0; b < size; b++) place[b] = y[(first + b) * p->inputs + k];
      chebyshev_rows(place, most, BLOCK, table);
      if (k != slope) continue;
      slopes(place, table, most, other);
      memcpy(table, other, most * BLOCK * sizeof(double));
    }
    for (long k = 0; k < p->count; k++)
      for (long i = 0; i < p->inputs; i++) {
        const double *row = tables + (i * most + p->degree[k * p->inputs + i]) * BLOCK;
        for (int b = 0; b < BLOCK; b++) terms[k * BLOCK + b] = i ? terms[k * BLOCK + b] * row[b] : row[b];
      }
    products(terms, p->count, BLOCK, p->readout, p->rank, sums);
    for (long b = 0; b < size; b++) place[b] = times[first + b];
    chebyshev_rows(place, p->terms, BLOCK, tables);
    if (rate) slopes(place, tables, p->terms, other);
    products(rate ? other : tables, p->terms, BLOCK, p->column, p->rank * p->dim, parts);
    for (long b = 0; b < size; b++)
      for (long i = 0; i < p->dim; i++) {
        double total = 0.0;
        for (long r = 0; r < p->rank; r++) total += sums[r * BLOCK + b] * parts[(r * p->dim + i) * BLOCK + b];
        out[(first + b) * p->dim + i] = total;
      }
  }
  free(tables);
  return 1;
}
