/* Derivatives along y by Taylor series, without bounds; see enclosures.h. */

#include "enclosures.h"
#include <stdlib.h>

#define MOST_VECTORS 4 /* of four columns that are computed together */

/* What the steps have in common. */
typedef struct {
  const entry *entries;
  long count, dim, columns, orders; /* orders: room for those of a series */
  double *series;                   /* of the entries of w A over a step, count x orders */
  int64_t *lengths;                 /* their terms that are not round-off */
  double *V, *rates;                /* dim x orders x width, and dim x width */
  double *sizes;                    /* of the entries of |w A|, count */
} motion_of_tangents;

/* Expand w A over a step. Returns how many terms V needs there: those of exp(|w A|),
   whose size is the root of that of |w A|^2, and one more than w A. */
static long expand(const motion_of_tangents *m, const double *rows, const double *signs, const double *table,
                   long points, double half, const double *units, double enough) {
  long orders = m->orders, most = 1;
  double *reach = m->V, *again = reach + m->dim, largest = 0.0, term = 1.0;
  memset(reach, 0, 2 * m->dim * sizeof *reach);
  for (long e = 0; e < m->count; e++) {
    long j = m->entries[e].j, n = orders;
    double *own = m->series + e * orders, size = 0.0;
    apply_table(table, rows + m->entries[e].place * points, points, orders, own);
    for (long k = 0; k < orders; k++) {
      own[k] *= signs[e] * half;
      size += fabs(own[k]);
    }
    while (n > 1 && fabs(own[n - 1]) <= enough * size) n--;
    m->lengths[e] = n;
    most = n + 1 > most ? n + 1 : most;
    m->sizes[e] = size;
    if (j < m->dim) reach[m->entries[e].i] += size * units[j];
  }
  for (long e = 0; e < m->count; e++)
    if (m->entries[e].j < m->dim) again[m->entries[e].i] += m->sizes[e] * reach[m->entries[e].j];
  for (long i = 0; i < m->dim; i++) largest = larger(again[i] / units[i], largest);
  largest = sqrt(largest);
  long n = 1;
  for (; n < orders && !(term <= enough); n++) term *= largest / n;
  most = n > most ? n : most;
  return most < orders ? most : orders;
}

/* Move columns of V over a step, from their first terms, which become those of the next step; four in a vector. */
INLINE void move_columns(const motion_of_tangents *m, long first, long orders, int vectors) {
  long width = 4 * vectors, stride = m->orders * width;
  for (long n = 0; n + 1 < orders; n++) {
    memset(m->rates, 0, m->dim * width * sizeof *m->rates);
    for (long e = 0; e < m->count; e++) {
      long j = m->entries[e].j, length = m->lengths[e] < n + 1 ? m->lengths[e] : n + 1;
      const double *a = m->series + e * m->orders;
      double *out = m->rates + m->entries[e].i * width;
      if (j >= m->dim) { /* a rate by a constant, which moves its own column alone */
        if (j >= first && j < first + width && n < m->lengths[e]) out[j - first] += a[n];
        continue;
      }
      const double *b = m->V + j * stride + n * width;
      v4 sums[MOST_VECTORS];
      for (int v = 0; v < vectors; v++) sums[v] = load4(out + 4 * v);
      for (long k = 0; k < length; k++, b -= width)
        for (int v = 0; v < vectors; v++) sums[v] += spread4(a[k]) * load4(b + 4 * v);
      for (int v = 0; v < vectors; v++) store4(out + 4 * v, sums[v]);
    }
    for (long i = 0; i < m->dim; i++)
      for (int v = 0; v < vectors; v++)
        store4(m->V + i * stride + (n + 1) * width + 4 * v, load4(m->rates + i * width + 4 * v) / (double)(n + 1));
  }
  for (long i = 0; i < m->dim; i++)
    for (int v = 0; v < vectors; v++) {
      double *own = m->V + i * stride + 4 * v;
      v4 total = load4(own + (orders - 1) * width);
      for (long n = orders - 2; n >= 0; n--) total += load4(own + n * width);
      store4(own, total);
    }
}

static void move(const motion_of_tangents *m, long first, long orders, long width) {
  if (width == 16) move_columns(m, first, orders, 4);
  else if (width == 8) move_columns(m, first, orders, 2);
  else move_columns(m, first, orders, 1);
}

EXPORTED int64_t hamsym_tangents(const double *rows, const entry *entries, const double *signs, int64_t count,
                                 int64_t dim, int64_t columns, const double *steps, const double *series,
                                 int64_t points, int64_t orders, double half, const double *units, double enough,
                                 double *found) {
  long width = columns > 8 ? 16 : columns > 4 ? 8 : 4, block = dim * width, each = count * orders;
  double *memory = malloc((points * each + block * (orders + 1 + points) + count) * sizeof *memory);
  int64_t *lengths = malloc((points * count + points) * sizeof *lengths), *needed = lengths + points * count;
  if (!memory || !lengths) {
    free(memory), free(lengths);
    return 0;
  }
  double *V = memory + points * each, *rates = V + block * orders, *values = rates + block;
  motion_of_tangents m = {entries, count, dim, columns, orders, memory, lengths, V, rates, values + block * points};
  for (long x = 0; x < points; x++) {
    m.series = memory + x * each, m.lengths = lengths + x * count;
    needed[x] = expand(&m, rows, signs, steps + x * points * orders, points, half, units, enough);
  }
  for (long first = 0; first < columns; first += width) {
    for (long i = 0; i < dim; i++)
      for (long c = 0; c < width; c++) V[i * orders * width + c] = i == first + c;
    for (long x = points - 1; x >= 0; x--) { /* points are in descending order */
      m.series = memory + x * each, m.lengths = lengths + x * count;
      move(&m, first, needed[x], width);
      for (long i = 0; i < dim; i++)
        for (long c = 0; c < width; c++) values[(i * width + c) * points + x] = V[i * orders * width + c];
    }
    for (long i = 0; i < dim; i++)
      for (long c = first; c < columns && c < first + width; c++)
        apply_table(series, values + (i * width + c - first) * points, points, points, found + (i * columns + c) * points);
  }
  free(memory), free(lengths);
  return 1;
}
