/* Arithmetic of balls whose mid-points are sums of two float64 numbers.

   A ball is (high, low, radius) and means the set of all x with |x - (high + low)| <= radius.

   Rounding. u = 2^-53; every operation rounds to nearest, no rounding mode is changed. Numbers in capitals are those
   of examples/guide/how_proofs_work.md, which proves each.

   1. two_sum and two_product return a rounded result and its exact error (Knuth 1998, section 4.2.2, theorem B;
      Boldo & Muller 2011, section 2), apart from underflow, which is below SMALL.
   2. With |l| <= 3u |h| for the arguments, the errors of sums and products of mid-points are below
      MIDDLE (|a| + |b|) and MIDDLE |ab|; Joldes, Muller & Popescu 2017 (theorems 3.1 and 5.1) have the sharp
      constants.
   3. A radius is a sum of products of numbers >= 0 with at most 16 roundings, each a factor in [1 - u, 1 + u], so that
      (1 + OUTWARD) times the computed number, plus SMALL, is an upper bound. Infinity and NaN remain what they are and
      pass no test r <= bound.
   4. Products that underflow are wrong by at most 2^-1075 each, so that UNDERFLOW bounds the error of thousands.
      It is added to factors of other products, which SMALL would make too large: they may multiply a component in
      a unit of 10^200.

   Functions. exp, sin and cos reduce their arguments with constants that are balls, and sum a Taylor series whose
   remainder is added to the radius; nothing is assumed about elementary functions of float64. log, atan and asin
   begin with such a value y, an arbitrary number, and enclose the difference by addition theorems:
   log(x) = y + log(x exp(-y)), and so on. An angle y of more than 2 is refused, because the theorems tell angles
   only up to 2 pi. What has no value is a ball of infinite radius. */

#ifndef HAMSYM_BALLS_H
#define HAMSYM_BALLS_H

#include "rows.h"

#define UNIT 0x1p-53
#define MIDDLE (32 * UNIT * UNIT) /* of a sum or a product of mid-points */
#define OUTWARD (64 * UNIT)       /* of a radius */
#define GUARD (8 * UNIT)          /* of a few operations in front of a larger bound */
#define SMALL 1e-290              /* of operations that underflow */
#define UNDERFLOW_ERROR 0x1p-1060 /* of products that underflow and are factors of others */

typedef struct { double high, low, radius; } ball;

/* A rounded result and its error. */
typedef struct { double high, low; } pair;

INLINE pair two_sum(double a, double b) {
  double s = a + b, t = s - a;
  return (pair){s, (a - (s - t)) + (b - t)};
}

INLINE pair two_product(double a, double b) {
  double p = a * b;
  return (pair){p, fma(a, b, -p)};
}

INLINE double outward(double value) { return value * (1 + OUTWARD) + SMALL; }

/* The radius, or infinity beside a mid-point that is not finite. */
INLINE double checked(double value, double radius) { return fabs(value) < INFINITY ? radius : INFINITY; }

/* An upper bound on the numbers of a ball. */
INLINE double absolute(ball x) { return outward(fabs(x.high) + fabs(x.low) + x.radius); }

/* A lower bound, without roundings of the radius. */
INLINE double least_of(ball x) { return x.high - fabs(x.low) - x.radius; }

INLINE ball ball_of(double value) { return (ball){value, 0.0, 0.0}; }

INLINE ball negative(ball x) { return (ball){-x.high, -x.low, x.radius}; }

INLINE ball middle_of(ball x) { return (ball){x.high, x.low, 0.0}; }

INLINE ball add(ball x, ball y) {
  pair first = two_sum(x.high, y.high), sum = two_sum(first.high, first.low + (x.low + y.low));
  double radius = outward(x.radius + y.radius + MIDDLE * (fabs(x.high) + fabs(y.high)));
  return (ball){sum.high, sum.low, checked(sum.high + sum.low, radius)};
}

INLINE ball subtract(ball x, ball y) { return add(x, negative(y)); }

INLINE ball multiply(ball x, ball y) {
  pair first = two_product(x.high, y.high);
  pair product = two_sum(first.high, first.low + (x.high * y.low + x.low * y.high));
  double a = fabs(x.high) + fabs(x.low), b = fabs(y.high) + fabs(y.low);
  double radius = outward(a * y.radius + x.radius * (b + y.radius) + MIDDLE * (a * b));
  return (ball){product.high, product.low, checked(product.high + product.low, radius)};
}

/* The product with a power of two. */
INLINE ball scaled(ball x, double factor) { return (ball){x.high * factor, x.low * factor, x.radius * factor + SMALL}; }

INLINE ball widened(ball x, double radius) { return (ball){x.high, x.low, outward(x.radius + radius)}; }

ball divide(ball x, ball y);
ball square_root(ball x);
ball exponential(ball x);
void sine_cosine(ball x, ball *sine, ball *cosine);
ball logarithm(ball x);
ball arctangent(ball x);
ball arcsine(ball x);
ball arccosine(ball x);
ball inverse_hyperbolic_sine(ball x);
ball inverse_hyperbolic_cosine(ball x);
ball inverse_hyperbolic_tangent(ball x);
ball error_function(ball x);

extern const ball HALF_PI;

#endif
