/* Functions of balls; see balls.h. */

#include "balls.h"
#include "functions.h"

/* Constants as balls, from exact arithmetic; the last is 1/k! for k < 32. */
static const ball LOG_2 = {0x1.62e42fefa39efp-1, 0x1.abc9e3b39803fp-56, 0x1.7b57a079a1934p-111};
const ball HALF_PI = {0x1.921fb54442d18p+0, 0x1.1a62633145c07p-54, 0x1.f1976b7ed8fbcp-110};
static const ball TWO_BY_ROOT_PI = {0x1.20dd750429b6dp+0, 0x1.1ae3a914fed80p-56, 0x1.3cbbebf65f146p-111};
static const ball INVERSE_FACTORIAL[] = {
  {0x1.0000000000000p+0, 0.0, 0.0},
  {0x1.0000000000000p+0, 0.0, 0.0},
  {0x1.0000000000000p-1, 0.0, 0.0},
  {0x1.5555555555555p-3, 0x1.5555555555555p-57, 0x1.5555555555556p-111},
  {0x1.5555555555555p-5, 0x1.5555555555555p-59, 0x1.5555555555556p-113},
  {0x1.1111111111111p-7, 0x1.1111111111111p-63, 0x1.1111111111112p-119},
  {0x1.6c16c16c16c17p-10, -0x1.f49f49f49f49fp-65, 0x1.27d27d27d27d3p-119},
  {0x1.a01a01a01a01ap-13, 0x1.a01a01a01a01ap-73, 0x1.a01a01a01a01bp-133},
  {0x1.a01a01a01a01ap-16, 0x1.a01a01a01a01ap-76, 0x1.a01a01a01a01bp-136},
  {0x1.71de3a556c734p-19, -0x1.c154f8ddc6c00p-73, 0x1.71de3a556c734p-127},
  {0x1.27e4fb7789f5cp-22, 0x1.cbbc05b4fa99ap-76, 0x1.c6d278883e8f5p-132},
  {0x1.ae64567f544e4p-26, -0x1.c062e06d1f209p-80, 0x1.c7880adcbc46ep-136},
  {0x1.1eed8eff8d898p-29, -0x1.2aec959e14c06p-83, 0x1.2fb0073dd2d9fp-139},
  {0x1.6124613a86d09p-33, 0x1.f28e0cc748ebep-87, 0x1.7b2c4c8a840bcp-141},
  {0x1.93974a8c07c9dp-37, 0x1.05d6f8a2efd1fp-92, 0x1.3aa3346236a5ep-147},
  {0x1.ae7f3e733b81fp-41, 0x1.1d8656b0ee8cbp-97, 0x1.6e142a138f825p-157},
  {0x1.ae7f3e733b81fp-45, 0x1.1d8656b0ee8cbp-101, 0x1.6e142a138f825p-161},
  {0x1.952c77030ad4ap-49, 0x1.ac981465ddc6cp-103, 0x1.588b72e53bc5fp-165},
  {0x1.6827863b97d97p-53, 0x1.eec01221a8b0bp-107, 0x1.568798662118bp-161},
  {0x1.2f49b46814157p-57, 0x1.2650f61dbdcb4p-112, 0x1.69502917cbf3bp-166},
  {0x1.e542ba4020225p-62, 0x1.ea72b4afe3c2fp-120, 0x1.44020dfd65c8dp-174},
  {0x1.71b8ef6dcf572p-66, -0x1.d043ae40c4647p-120, 0x1.486121e81d5fep-176},
  {0x1.0ce396db7f853p-70, -0x1.aebcdbd20331cp-124, 0x1.38a88578b4d75p-178},
  {0x1.761b41316381ap-75, -0x1.3423c7d91404fp-130, 0x1.e6135bfc1194ap-185},
  {0x1.f2cf01972f578p-80, -0x1.9ada5fcc1ab14p-135, 0x1.440ce7fd610dcp-189},
  {0x1.3f3ccdd165fa9p-84, -0x1.58ddadf344487p-139, 0x1.e8ed8001ad67ep-193},
  {0x1.88e85fc6a4e5ap-89, -0x1.71c37ebd16540p-143, 0x1.494676265a364p-197},
  {0x1.d1ab1c2dccea3p-94, 0x1.054d0c78aea14p-149, 0x1.196bf16c33a56p-203},
  {0x1.0a18a2635085dp-98, 0x1.b9e2e28e1aa54p-153, 0x1.a8549a9d99586p-207},
  {0x1.259f98b4358adp-103, 0x1.eaf8c39dd9bc5p-157, 0x1.6e29990a26fb7p-211},
  {0x1.3932c5047d60ep-108, 0x1.832b7b530a627p-162, 0x1.5d2c61f6d124dp-218},
  {0x1.434d2e783f5bcp-113, 0x1.0b87b91be9affp-167, 0x1.c89db1796db75p-224},
};

#define LEAST_EXPONENTIAL 1e-287 /* above exp(x) where its power of two is below -960 */
#define REST_EXPONENTIAL 1e-9    /* above 2/13! */
#define REST_SINE 1e-35          /* above 0.8^30/30! */
#define REST_ERROR_FUNCTION 1e-34
#define SLOPE (16 * UNIT) /* of the slope of a function at the end of a ball */
#define EDGE (4 * UNIT)   /* of the arcsine's domain */

static ball invalid(void) { return (ball){NAN, NAN, INFINITY}; }

static double power(double x, int n) {
  double found = x;
  while (--n) found *= x;
  return found;
}

/* x / y, from y q = 1 - e: x / y = x q (1 + e / (1 - e)). */
ball divide(ball x, ball y) {
  ball first = ball_of(1 / y.high);
  ball rest = subtract(ball_of(1.0), multiply(y, first));
  ball q = middle_of(add(first, ball_of(first.high * rest.high)));
  rest = subtract(ball_of(1.0), multiply(y, q));
  double error = absolute(rest);
  if (!(error < 0.5)) return invalid();
  ball product = multiply(x, q);
  return widened(product, absolute(product) * error / (1 - error));
}

/* The square root, from q^2 = x - e: |sqrt(x) - q| <= |e| / q. */
ball square_root(ball x) {
  if (!(least_of(x) > 0)) return invalid();
  double first = sqrt(x.high);
  ball rest = subtract(x, multiply(ball_of(first), ball_of(first)));
  pair better = two_sum(first, 0.5 * rest.high / first);
  ball q = {better.high, better.low, 0.0};
  rest = subtract(x, multiply(q, q));
  return widened(q, absolute(rest) / (q.high - fabs(q.low)) * (1 + GUARD));
}

ball exponential(ball x) {
  if (!(x.radius <= 1 && fabs(x.high) <= 1e5)) return invalid();
  double k = floor(x.high / LOG_2.high + 0.5);
  if (k > 1000) return invalid();
  /* exp(x) < 2^-960 exp(2) < 1e-287, because x < (k + 1) log(2) + r. */
  if (k < -960) return (ball){0.0, 0.0, LEAST_EXPONENTIAL};
  ball y = scaled(subtract(middle_of(x), multiply(ball_of(k), LOG_2)), 0x1p-8);
  double size = absolute(y);
  if (!(size <= 0.01)) return invalid();
  ball total = ball_of(0.0);
  for (int j = 12; j > 0; j--) total = multiply(y, add(INVERSE_FACTORIAL[j], total));
  /* The tail is below twice its first term. */
  total = widened(total, power(size, 13) * REST_EXPONENTIAL);
  for (int j = 0; j < 8; j++) total = add(scaled(total, 2.0), multiply(total, total)); /* (1 + p)^2 - 1 */
  total = scaled(add(ball_of(1.0), total), ldexp(1.0, (int)k));
  /* |exp(m + d) - exp(m)| <= exp(m) (exp(r) - 1) <= exp(m) 2 r, because r <= 1. */
  return widened(total, absolute(total) * 2 * x.radius);
}

void sine_cosine(ball x, ball *sine, ball *cosine) {
  *sine = *cosine = invalid();
  double k = floor(x.high / HALF_PI.high + 0.5);
  if (!(fabs(k) <= 0x1p40)) return;
  ball y = subtract(middle_of(x), multiply(ball_of(k), HALF_PI));
  if (!(absolute(y) <= 0.8)) return;
  ball square = multiply(y, y), s = ball_of(0.0), c = ball_of(0.0);
  for (int j = 14; j > 0; j--) {
    ball even = INVERSE_FACTORIAL[2 * j], odd = INVERSE_FACTORIAL[2 * j + 1];
    c = multiply(square, add(j % 2 ? negative(even) : even, c));
    s = multiply(square, add(j % 2 ? negative(odd) : odd, s));
  }
  /* The terms decrease with alternating signs: the rest is below 0.8^30/30!. */
  c = widened(add(ball_of(1.0), c), REST_SINE + x.radius);
  s = widened(add(y, multiply(y, s)), REST_SINE + x.radius);
  switch ((int64_t)k & 3) {
    case 0: *sine = s; *cosine = c; break;
    case 1: *sine = c; *cosine = negative(s); break;
    case 2: *sine = negative(s); *cosine = negative(c); break;
    default: *sine = negative(c); *cosine = s;
  }
}

ball logarithm(ball x) {
  double low = least_of(x);
  if (!(low > 0)) return invalid();
  ball y = ball_of(value_at(hamsym_log, x.high));
  ball z = add(multiply(middle_of(x), exponential(negative(y))), ball_of(-1.0));
  double size = absolute(z);
  if (!(size <= 1e-3)) return invalid();
  /* z - z^2/2 + z^3/3 - ..., the rest below |z|^4. */
  ball square = multiply(z, z), cube = multiply(multiply(square, z), (ball){1.0 / 3, 0.0, UNIT});
  ball found = add(add(y, z), add(scaled(square, -0.5), cube));
  found = widened((ball){found.high, found.low, fabs(found.radius)}, power(size, 4));
  /* |log(m + d) - log(m)| <= r / (m - r); where m - r loses half of itself, the logarithm is far below that. */
  return widened(found, x.radius > 0 ? x.radius / low * (1 + SLOPE) : 0.0);
}

/* The number as a ball; NaN, which no test admits, unless it is within [-2, 2]. */
static ball guessed_angle(double value) { return ball_of(fabs(value) <= 2 ? value : NAN); }

ball arctangent(ball x) {
  ball y = guessed_angle(value_at(hamsym_atan, x.high)), middle = middle_of(x), sine, cosine;
  sine_cosine(y, &sine, &cosine);
  ball below = add(cosine, multiply(middle, sine));
  /* A positive cosine means that atan(x) - y is between -pi/2 and pi/2: it is within 3 pi/2, because |y| <= 2. */
  if (!(least_of(below) > 0)) return invalid();
  ball z = divide(subtract(multiply(middle, cosine), sine), below);
  double size = absolute(z);
  if (!(size <= 1e-3)) return invalid();
  return widened(add(y, z), power(size, 3) + x.radius);
}

ball arcsine(ball x) {
  double outer = fabs(x.high) + fabs(x.low) + x.radius;
  if (!(outer < 1 - EDGE)) return invalid();
  ball y = guessed_angle(value_at(hamsym_asin, x.high)), middle = middle_of(x), sine, cosine;
  sine_cosine(y, &sine, &cosine);
  ball beside = square_root(subtract(ball_of(1.0), multiply(middle, middle)));
  ball inner = add(multiply(beside, cosine), multiply(middle, sine)); /* as in arctangent */
  if (!(least_of(inner) > 0)) return invalid();
  ball z = subtract(multiply(middle, cosine), multiply(beside, sine));
  double size = absolute(z);
  if (!(size <= 1e-3)) return invalid();
  ball found = widened(add(y, z), power(size, 3));
  if (x.radius > 0) { /* the derivative is largest at the outer end */
    double room = (1 - outer) * (1 - GUARD);
    found = widened(found, x.radius / sqrt(room) * (1 + SLOPE));
  }
  return found;
}

ball arccosine(ball x) { return subtract(HALF_PI, arcsine(x)); }

ball inverse_hyperbolic_sine(ball x) {
  if (x.high < 0) return negative(inverse_hyperbolic_sine(negative(x)));
  ball middle = middle_of(x), beside = square_root(add(ball_of(1.0), multiply(middle, middle)));
  return widened(logarithm(add(middle, beside)), x.radius);
}

ball inverse_hyperbolic_cosine(ball x) {
  ball product = multiply(add(x, ball_of(1.0)), add(x, ball_of(-1.0)));
  return logarithm(add(x, square_root(product)));
}

ball inverse_hyperbolic_tangent(ball x) {
  ball above = logarithm(add(ball_of(1.0), x));
  return scaled(subtract(above, logarithm(subtract(ball_of(1.0), x))), 0.5);
}

ball error_function(ball x) {
  if (!(fabs(x.high) <= 1e100)) return invalid();
  if (fabs(x.high) > 6) { /* 1 - erf(|x|) < exp(-x^2) < 2^-51 2^-(|x| - 6) */
    double rest = ldexp(1.0, -(int)lesser(45 + floor(fabs(x.high)), 960.0));
    return (ball){x.high > 0 ? 1.0 : -1.0, 0.0, outward(rest + 2 * x.radius)};
  }
  ball middle = middle_of(x), square = multiply(middle, middle), power = middle, total = middle;
  for (int count = 1; count <= 400; count++) {
    power = divide(multiply(power, negative(square)), ball_of(count));
    ball term = divide(power, ball_of(2.0 * count + 1));
    total = add(total, term);
    double size = absolute(term);
    /* From |x|^2 < n / 2 on each term is below half of the one before. */
    if (count > 2 * absolute(square) && size < REST_ERROR_FUNCTION)
      return widened(multiply(widened(total, size), TWO_BY_ROOT_PI), 2 * x.radius);
  }
  return invalid();
}

static ball bound_of(ball x) { return ball_of(absolute(x)); }

/* Functions of balls by number, n times: out[k] of x[k] and, where there are two arguments, y[k]. The last number
   is sine and cosine, which are out[2 k] and out[2 k + 1]. A ball is scaled by a mid-point, a power of two. */
EXPORTED void hamsym_balls(int64_t function, int64_t n, const ball *x, const ball *y, ball *out) {
  static ball (*const one[])(ball) = {bound_of, square_root, exponential, logarithm, arctangent, arcsine, arccosine,
                                      inverse_hyperbolic_sine, inverse_hyperbolic_cosine,
                                      inverse_hyperbolic_tangent, error_function};
  for (int64_t k = 0; k < n; k++) {
    if (function == 0) out[k] = add(x[k], y[k]);
    else if (function == 1) out[k] = multiply(x[k], y[k]);
    else if (function == 2) out[k] = divide(x[k], y[k]);
    else if (function == 3) out[k] = scaled(x[k], y[k].high);
    else if (function < 15) out[k] = one[function - 4](x[k]);
    else sine_cosine(x[k], out + 2 * k, out + 2 * k + 1);
  }
}
