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

typedef double v4 __attribute__((vector_size(32), aligned(8), may_alias));
typedef int64_t i4 __attribute__((vector_size(32)));

INLINE v4 spread(double x) { return (v4){x, x, x, x}; }
INLINE v4 load(const double *p) { return *(const v4 *)p; }
INLINE void store(double *p, v4 x) { *(v4 *)p = x; }
INLINE v4 choose(i4 condition, v4 x, v4 y) { return (v4)((condition & (i4)x) | (~condition & (i4)y)); }
INLINE v4 size4(v4 x) { return (v4)((i4)x & (i4){INT64_MAX, INT64_MAX, INT64_MAX, INT64_MAX}); }

/* The larger of two magnitudes; NaN if one is. Their bits are ordered as they are, with NaN as the largest. */
INLINE v4 larger4(v4 x, v4 y) {
#if defined(__AVX512VL__)
  return (v4)_mm256_max_epi64((__m256i)x, (__m256i)y);
#elif defined(__AVX2__)
  return choose((i4)x > (i4)y, x, y);
#else
  return choose((i4)(x > y) | (i4)(x != x), x, y); /* of old processors the faster way */
#endif
}
/* The same of two numbers that are not negative, without branches, which no processor could predict. */
INLINE double larger(double x, double y) {
  double most = x > y ? x : y;
  return x != x ? x : most;
}
INLINE double largest4(v4 x) {
  x = larger4((v4){x[2], x[3], x[0], x[1]}, x);
  return larger4((v4){x[1], x[0], x[3], x[2]}, x)[0];
}

/* The larger and the smaller of two numbers of which none is NaN. */
INLINE double greater(double x, double y) { return x > y ? x : y; }
INLINE double lesser(double x, double y) { return x < y ? x : y; }

/* -- products ---------------------------------------------------------------------------------- */

/* Sums over a table at some columns: `width` vectors for each of `height` rows. Both are constants
   where this is called, so that the accumulators stay in registers. */
INLINE void add_up(const double *table, long n, long k, const double *rows, int height, int width, v4 *sums) {
  __asm__("" : "+r"(n)); /* unrolled, the loop has more values at once than registers hold */
  for (int j = 0; j < height * width; j++) sums[j] = spread(0.0);
  for (long m = 0; m < n; m++)
    for (int i = 0; i < height; i++) {
      v4 value = spread(rows[i * n + m]);
      for (int j = 0; j < width; j++) sums[i * width + j] += value * load(table + m * k + 4 * j);
    }
}

typedef struct {
  const double *base;
  double *states;
  v4 *changes; /* largest changes in each row, by lane */
  double h;
} motion;

/* Write a tile of a product; or base + h times it, and how far that is from the states before. */
INLINE void tile(const double *table, long n, long k, const double *rows, long row, long column, int height,
                 int width, double *out, const motion *moved) {
  v4 sums[12];
  add_up(table + column, n, k, rows + row * n, height, width, sums);
  for (int i = 0; i < height; i++) {
    long place = (row + i) * k + column;
    v4 most = moved ? moved->changes[row + i] : spread(0.0);
    for (int j = 0; j < width; j++, place += 4) {
      v4 found = sums[i * width + j];
      if (moved) {
        found = load(moved->base + place) + spread(moved->h) * found;
        most = larger4(size4(found - load(moved->states + place)), most);
      }
      store((moved ? moved->states : out) + place, found);
    }
    if (moved) moved->changes[row + i] = most;
  }
}

INLINE void cover(const double *table, long n, long k, const double *rows, long count, double *out,
                  const motion *moved) {
  long row = 0;
  for (; k == 8 && row + 4 <= count; row += 4) tile(table, n, k, rows, row, 0, 4, 2, out, moved);
  for (; row + 2 <= count; row += 2) {
    long column = 0;
    for (; column + 16 <= k && k - column != 24; column += 16) tile(table, n, k, rows, row, column, 2, 4, out, moved);
    if (k - column == 24) tile(table, n, k, rows, row, column, 2, 6, out, moved);
    else if (column < k) tile(table, n, k, rows, row, column, 2, 2, out, moved);
  }
  if (row < count) {
    long column = 0;
    for (; column + 32 <= k; column += 32) tile(table, n, k, rows, row, column, 1, 8, out, moved);
    for (; column + 16 <= k && k - column != 24; column += 16) tile(table, n, k, rows, row, column, 1, 4, out, moved);
    if (k - column == 24) tile(table, n, k, rows, row, column, 1, 6, out, moved);
    else if (column < k) tile(table, n, k, rows, row, column, 1, 2, out, moved);
  }
}

/* Multiply rows (count x n) by a table (n x k) into out (count x k). */
static inline void products(const double *table, long n, long k, const double *rows, long count, double *out) {
  cover(table, n, k, rows, count, out, 0);
}

/* Replace states by base + h rows table. */
static inline void advance(const double *table, long n, const double *rows, long count, const double *base,
                           double h, double *states, v4 *changes) {
  motion moved = {base, states, changes, h};
  for (long i = 0; i < count; i++) changes[i] = spread(0.0);
  cover(table, n, n, rows, count, 0, &moved);
}

/* Largest product of a row's change and weight; NaN if there is one. */
static inline double weighted_change(const v4 *changes, const double *weights, long count) {
  v4 found = spread(0.0);
  for (long i = 0; i < count; i++) found = larger4(size4(changes[i] * spread(weights[i])), found);
  return largest4(found);
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
  v4 twice[4], last[4], now[4];
  for (int j = 0; j < width; j++) {
    now[j] = load(x + 4 * j);
    twice[j] = spread(2.0) * now[j];
    last[j] = spread(1.0);
  }
  for (long k = 0; k < terms; k++, out += n)
    for (int j = 0; j < width; j++) {
      v4 next = twice[j] * now[j] - last[j];
      store(out + 4 * j, last[j]);
      last[j] = now[j];
      now[j] = next;
    }
}

/* Chebyshev polynomials at x, a row of n numbers for each degree below `terms`. */
static inline void chebyshev_rows(const double *x, long terms, long n, double *out) {
  long c = 0;
  for (; c + 16 <= n; c += 16) recur(x + c, terms, n, 4, out + c);
  if (c < n) recur(x + c, terms, n, 2, out + c);
}

/* -- one row ----------------------------------------------------------------------------------- */

/* Sum of the products of two rows. */
static inline double dot(const double *a, const double *b, long n) {
  v4 one = spread(0.0), other = spread(0.0);
  for (long c = 0; c < n; c += 8) {
    one += load(a + c) * load(b + c);
    other += load(a + c + 4) * load(b + c + 4);
  }
  one += other;
  return (one[0] + one[1]) + (one[2] + one[3]);
}

/* Largest magnitude; NaN if there is one. */
static inline double row_size(const double *row, long n) {
  v4 found = spread(0.0);
  for (long c = 0; c < n; c += 4) found = larger4(size4(load(row + c)), found);
  return largest4(found);
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
