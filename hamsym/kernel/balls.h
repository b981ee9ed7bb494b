/* Arithmetic of balls whose mid-points are sums of two float64 numbers.

   A ball is (high, low, radius) and means the set of all x with |x - (high + low)| <= radius.

   u = 2^-53; every operation rounds to nearest, no rounding mode is changed. Lemmas 1 to 8 of
   examples/guide/how_proofs_work.md prove the bounds and the constants. Infinity and NaN remain what they are and pass
   no test r <= bound.

   exp, sin and cos reduce their arguments with constants that are balls, and sum a Taylor series; nothing is assumed
   about elementary functions of float64. log, atan and asin begin with such a value y, an arbitrary number, and
   enclose the difference by addition theorems. An angle y of more than 2 is refused, because the theorems tell angles
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
