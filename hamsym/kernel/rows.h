/* Rows of float64 numbers, and products of rows and tables.

   A row has n numbers, one for each node of a window, and n is a multiple of eight; a matrix has its
   rows one after the other. Tables multiply rows from the right: one from n values to k is n x k.
   Every sum has a fixed order and nothing is contracted, so that results have the same bits with
   vector instructions of any width. */

#ifndef HAMSYM_ROWS_H
#define HAMSYM_ROWS_H

#include <math.h>
#include <stdint.h>
#include <string.h>
#if defined(__AVX512VL__)
#include <immintrin.h>
#endif

#define EPS 0x1p-52
#define TINY 0x1p-1022
#define LINE 8 /* numbers in a line of the cache */
#define INLINE static inline __attribute__((always_inline))
#define EXPORTED __attribute__((visibility("default")))

/* As many numbers as the vector registers of the processor hold, and four, where the order of a sum depends on it. */
#if defined(__AVX512VL__)
#define LANES 8
#elif defined(__AVX2__)
#define LANES 4
#else
#define LANES 2
#endif
typedef double vw __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef int64_t iw __attribute__((vector_size(8 * LANES)));
typedef double v4 __attribute__((vector_size(32), aligned(8), may_alias));
typedef int64_t i4 __attribute__((vector_size(32)));

INLINE v4 spread4(double x) { return (v4){x, x, x, x}; }
INLINE v4 load4(const double *p) { return *(const v4 *)p; }
INLINE void store4(double *p, v4 x) { *(v4 *)p = x; }
INLINE v4 size4(v4 x) { return (v4)((i4)x & INT64_MAX); }

INLINE vw spread(double x) { return x - (vw){0.0}; }
INLINE vw load(const double *p) { return *(const vw *)p; }
INLINE void store(double *p, vw x) { *(vw *)p = x; }
INLINE vw choose(iw condition, vw x, vw y) { return (vw)((condition & (iw)x) | (~condition & (iw)y)); }
INLINE vw magnitudes(vw x) { return (vw)((iw)x & INT64_MAX); }

/* The larger of two magnitudes; NaN if one is. Their bits are ordered as they are, with NaN as the largest. */
INLINE vw larger_lanes(vw x, vw y) {
#if defined(__AVX512VL__)
  return (vw)_mm512_max_epi64((__m512i)x, (__m512i)y);
#elif defined(__AVX2__)
  return choose((iw)x > (iw)y, x, y);
#else
  return choose((iw)(x > y) | (iw)(x != x), x, y); /* of old processors the faster way */
#endif
}
/* The same of two numbers that are not negative, without branches, which no processor could predict. */
INLINE double larger(double x, double y) {
  double most = x > y ? x : y;
  return x != x ? x : most;
}
INLINE double largest_lane(vw x) {
#if defined(__AVX512VL__)
  int64_t bits = _mm512_reduce_max_epi64((__m512i)x);
  double found;
  memcpy(&found, &bits, sizeof found);
  return found;
#elif defined(__AVX2__)
  x = larger_lanes((vw){x[2], x[3], x[0], x[1]}, x);
  return larger_lanes((vw){x[1], x[0], x[3], x[2]}, x)[0];
#else
  return larger(x[0], x[1]);
#endif
}

/* The larger and the smaller of two numbers of which none is NaN. */
INLINE double greater(double x, double y) { return x > y ? x : y; }
INLINE double lesser(double x, double y) { return x < y ? x : y; }

/* -- products ---------------------------------------------------------------------------------- */

/* Sums over a table at some columns: `width` vectors for each of `height` rows. Both are constants
   where this is called, so that the accumulators stay in registers. */
INLINE void add_up(const double *table, long n, long k, const double *rows, int height, int width, vw *sums) {
  __asm__("" : "+r"(n)); /* unrolled, the loop has more values at once than registers hold */
  for (int j = 0; j < height * width; j++) sums[j] = (vw){0.0};
  for (long m = 0; m < n; m++)
    for (int i = 0; i < height; i++) {
      double value = rows[i * n + m];
      for (int j = 0; j < width; j++) sums[i * width + j] += value * load(table + m * k + LANES * j);
    }
}

typedef struct {
  const double *base;
  double *states;
  vw *changes; /* largest changes in each row, by lane */
  double h;
} motion;

/* Write a tile of a product; or base + h times it, and how far that is from the states before. */
INLINE void tile(const double *table, long n, long k, const double *rows, long row, long column, int height,
                 int columns, double *out, const motion *moved) {
  int width = columns / LANES;
  vw sums[12];
  add_up(table + column, n, k, rows + row * n, height, width, sums);
  for (int i = 0; i < height; i++) {
    long place = (row + i) * k + column;
    vw most = moved ? moved->changes[row + i] : (vw){0.0};
    for (int j = 0; j < width; j++, place += LANES) {
      vw found = sums[i * width + j];
      if (moved) {
        found = load(moved->base + place) + moved->h * found;
        most = larger_lanes(magnitudes(found - load(moved->states + place)), most);
      }
      store((moved ? moved->states : out) + place, found);
    }
    if (moved) moved->changes[row + i] = most;
  }
}

/* Write what is left of a product from a row on, by tiles of so many rows; return the next row. */
INLINE long cover_by(int height, const double *table, long n, long k, const double *rows, long row, long count,
                     double *out, const motion *moved) {
  for (; row + height <= count; row += height) {
    long column = 0;
    for (; height == 1 && LANES > 2 && column + 32 <= k; column += 32)
      tile(table, n, k, rows, row, column, height, 32, out, moved);
    for (; column + 16 <= k && k - column != 24; column += 16)
      tile(table, n, k, rows, row, column, height, 16, out, moved);
    if (k - column == 24) tile(table, n, k, rows, row, column, height, 24, out, moved);
    else if (column < k) tile(table, n, k, rows, row, column, height, 8, out, moved);
  }
  return row;
}

INLINE void cover(const double *table, long n, long k, const double *rows, long count, double *out,
                  const motion *moved) {
  long row = 0;
  for (; k == 8 && row + LANES <= count; row += LANES) tile(table, n, k, rows, row, 0, LANES, 8, out, moved);
  row = cover_by(LANES / 2, table, n, k, rows, row, count, out, moved);
  if (LANES > 4) row = cover_by(2, table, n, k, rows, row, count, out, moved);
  cover_by(1, table, n, k, rows, row, count, out, moved);
}

/* Multiply rows (count x n) by a table (n x k) into out (count x k). */
static inline void products(const double *table, long n, long k, const double *rows, long count, double *out) {
  cover(table, n, k, rows, count, out, 0);
}

/* Replace states by base + h rows table. */
static inline void advance(const double *table, long n, const double *rows, long count, const double *base,
                           double h, double *states, vw *changes) {
  motion moved = {base, states, changes, h};
  for (long i = 0; i < count; i++) changes[i] = (vw){0.0};
  cover(table, n, n, rows, count, 0, &moved);
}

/* Largest product of a row's change and weight; NaN if there is one. */
static inline double weighted_change(const vw *changes, const double *weights, long count) {
  vw found = {0.0};
  for (long i = 0; i < count; i++) found = larger_lanes(magnitudes(changes[i] * weights[i]), found);
  return largest_lane(found);
}

/* Sum of a row with weights that are high and low parts. */
static inline double weighted_sum(const double *row, const double *weights, const double *low, long n) {
  double total = 0.0, rest = 0.0;
  for (long m = 0; m < n; m++) {
    total += row[m] * weights[m];
    if (low) rest += row[m] * low[m];
  }
  return total + rest;
}

/* Chebyshev polynomials at `width` vectors of places, a constant, in registers: a step waits for the one before. */
INLINE void recur(const double *x, long terms, long n, int width, double *out) {
  vw twice[8], last[8], now[8];
  for (int j = 0; j < width; j++) {
    now[j] = load(x + LANES * j);
    twice[j] = 2.0 * now[j];
    last[j] = spread(1.0);
  }
  for (long k = 0; k < terms; k++, out += n)
    for (int j = 0; j < width; j++) {
      vw next = twice[j] * now[j] - last[j];
      store(out + LANES * j, last[j]);
      last[j] = now[j];
      now[j] = next;
    }
}

/* Chebyshev polynomials at x, a row of n numbers for each degree below `terms`. */
static inline void chebyshev_rows(const double *x, long terms, long n, double *out) {
  long c = 0;
  for (; c + 16 <= n; c += 16) recur(x + c, terms, n, 16 / LANES, out + c);
  if (c < n) recur(x + c, terms, n, 8 / LANES, out + c);
}

/* -- one row ----------------------------------------------------------------------------------- */

/* Sum of the products of two rows, in eight parts. */
static inline double dot(const double *a, const double *b, long n) {
  vw sums[8 / LANES] = {{0.0}};
  for (long c = 0; c < n; c += 8)
    for (int j = 0; j < 8 / LANES; j++) sums[j] += load(a + c + LANES * j) * load(b + c + LANES * j);
  v4 part[2];
  memcpy(part, sums, sizeof part);
  part[0] += part[1];
  return (part[0][0] + part[0][1]) + (part[0][2] + part[0][3]);
}

/* Largest magnitude; NaN if there is one. */
static inline double row_size(const double *row, long n) {
  vw found = {0.0};
  for (long c = 0; c < n; c += LANES) found = larger_lanes(magnitudes(load(row + c)), found);
  return largest_lane(found);
}

static inline void fill(double *row, double value, long n) {
  for (long c = 0; c < n; c++) row[c] = value;
}

static inline void shift(double *rows, const double *values, long count, long n) {
  for (long i = 0; i < count; i++)
    for (long c = 0; c < n; c++) rows[i * n + c] += values[i];
}

/* Rows whose numbers are changed by a share of themselves, with these signs. */
static inline void disturb(const double *rows, const double *signs, long stride, double share, long count, long n,
                           double *out) {
  for (long i = 0; i < count; i++)
    for (long c = 0; c < n; c++) out[i * n + c] = rows[i * n + c] * (1.0 + share * signs[i * stride + c]);
}

#endif
