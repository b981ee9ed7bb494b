/* Elementary functions of rows of float64: reduction to a small interval, a polynomial, reconstruction.
 *
 * Several numbers go through each function together. Arguments that the common formula does not cover (zeros,
 * infinities, far angles) are found by one test for all, and computed one by one. Where the rounding of an
 * intermediate value would show in the result, the value is kept as an unevaluated sum hi + lo of two numbers.
 */
#include "functions.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
#if defined(__SSE2__)
#include <immintrin.h>
#endif

/* Every function that takes or returns a vector is inlined or static, so no caller can meet another ABI. */
#pragma GCC diagnostic ignored "-Wpsabi"

/* How many numbers go through a function together changes its speed, no bit of a result. clang orders the instructions
 * of two registers so that neither waits for the other; gcc would pass them through memory, unless one has them all. */
#if defined(__clang__) || defined(__AVX512F__)
#define AT_ONCE 8
#else
#define AT_ONCE 4
#endif

typedef double reals __attribute__((vector_size(8 * AT_ONCE)));
typedef uint64_t words __attribute__((vector_size(8 * AT_ONCE)));
typedef struct {
    reals hi, lo;
} pair; /* the number hi + lo */

#define LANES static inline __attribute__((always_inline))

#define SIGN 0x8000000000000000u
#define ONE_EXPONENT 0x3ff0000000000000u /* the bits of 1.0 */
#define SMALLEST_NORMAL 0x1p-1022
#define LARGEST 0x1.fffffffffffffp1023
#define PI_HI 0x1.921fb54442d18p+1
#define PI_LO 0x1.1a62633145c07p-53
#define ROUNDER 0x1.8p52 /* x + ROUNDER has the integer nearest to x in its low bits */

/* ---- lanes ---- */

LANES reals load(const double *p) {
    reals x;
    memcpy(&x, p, sizeof x);
    return x;
}

LANES reals all(double x) { return x - (reals){0.0}; }

LANES reals where(words mask, reals yes, reals no) { return (reals)((mask & (words)yes) | (~mask & (words)no)); }

/* Flags of lanes are sign bits: integer instructions find them, where gcc compares lanes of SSE2 one by one. */
LANES int flagged(uint64_t flag) { return (int)(flag >> 63); }

LANES int any(words flags) {
    uint64_t either = 0;
    for (int i = 0; i < AT_ONCE; i++) either |= flags[i];
    return flagged(either);
}

static inline uint64_t bits_of(double x) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* Flags the lanes outside [low, high], 0 <= low <= high, and NaN. */
LANES words outside(reals x, double low, double high) { return ((words)x - bits_of(low)) | (bits_of(high) - (words)x); }

LANES reals absolute(reals x) { return (reals)((words)x & ~SIGN); }

/* size, which is not negative, with the sign of x */
LANES reals signed_as(reals size, reals x) { return (reals)((words)size | ((words)x & SIGN)); }

LANES reals at_most(reals x, double bound) { return where((words)(x > bound), all(bound), x); }

LANES reals at_least(reals x, double bound) { return where((words)(x < bound), all(bound), x); }

/* x, negated where of is negative */
LANES reals times_sign(reals x, reals of) { return (reals)((words)x ^ ((words)of & SIGN)); }

/* The square root in each lane; an instruction, where __builtin_sqrt may call the C library for errno. */
LANES reals square_root(reals x) {
#if defined(__AVX__)
    __m256d part[AT_ONCE / 4];
    memcpy(part, &x, sizeof x);
    for (int i = 0; i < AT_ONCE / 4; i++) part[i] = _mm256_sqrt_pd(part[i]);
    memcpy(&x, part, sizeof x);
#elif defined(__SSE2__)
    __m128d part[AT_ONCE / 2];
    memcpy(part, &x, sizeof x);
    for (int i = 0; i < AT_ONCE / 2; i++) part[i] = _mm_sqrt_pd(part[i]);
    memcpy(&x, part, sizeof x);
#else
    for (int i = 0; i < AT_ONCE; i++) x[i] = __builtin_sqrt(x[i]);
#endif
    return x;
}

static __attribute__((noinline)) void replace(double (*other)(double, double), const reals *x, const reals *y,
                                              const words *flags, reals *value) {
    for (int i = 0; i < AT_ONCE; i++)
        if (flagged((*flags)[i])) (*value)[i] = other((*x)[i], (*y)[i]);
}

/* value, but other(x, y) in flagged lanes; the vectors of the common path stay in registers */
LANES reals with_others(reals value, words flags, double (*other)(double, double), reals x, reals y) {
    if (__builtin_expect(any(flags), 0)) {
        reals rare = value;
        replace(other, &x, &y, &flags, &rare);
        return rare;
    }
    return value;
}

/* Apply a function of lanes to the row. */
LANES void map(reals (*function)(reals), const double *x, double *out, long n) {
    for (long i = 0; i < n; i += AT_ONCE) {
        reals r = function(load(x + i));
        memcpy(out + i, &r, sizeof r);
    }
}

LANES void map_two(reals (*function)(reals, reals), const double *x, const double *y, double *out, long n) {
    for (long i = 0; i < n; i += AT_ONCE) {
        reals r = function(load(x + i), load(y + i));
        memcpy(out + i, &r, sizeof r);
    }
}

/* ---- numbers of twice the precision ---- */

/* a + b for |a| >= |b|, or a = 0 */
LANES pair ordered_sum(reals a, reals b) {
    reals s = a + b;
    return (pair){s, (a - s) + b};
}

/* a + b (Knuth) */
LANES pair exact_sum(reals a, reals b) {
    reals s = a + b, from_b = s - a, from_a = s - from_b;
    return (pair){s, (a - from_a) + (b - from_b)};
}

/* a * b (Dekker), to 2^-105: cut into 26 and 27 bits, only the product of the two lower parts may round */
LANES pair exact_product(reals a, reals b) {
    words upper = (words){0} + ~(uint64_t)0x7ffffff;
    reals p = a * b, ah = (reals)((words)a & upper), bh = (reals)((words)b & upper), al = a - ah, bl = b - bh;
    return (pair){p, (((ah * bh - p) + ah * bl) + al * bh) + al * bl};
}

LANES pair product(pair a, pair b) {
    pair p = exact_product(a.hi, b.hi);
    return ordered_sum(p.hi, p.lo + (a.hi * b.lo + a.lo * b.hi));
}

LANES pair quotient(pair a, pair b) {
    reals inverse = 1.0 / b.hi, q = a.hi * inverse;
    pair back = exact_product(q, b.hi);
    reals rest = ((a.hi - back.hi) - back.lo) + (a.lo - q * b.lo);
    return ordered_sum(q, rest * inverse);
}

LANES pair root(pair a) {
    reals h = square_root(a.hi);
    pair back = exact_product(h, h);
    reals rest = ((a.hi - back.hi) - back.lo) + a.lo;
    return (pair){h, where((words)(h == 0.0), all(0.0), rest / (2.0 * h))};
}

/* ---- sin, cos, tan ---- */

/* The bits of 2/pi, after 64 zeros. */
static const uint64_t two_over_pi[20] = {
    0x0000000000000000, 0xa2f9836e4e441529, 0xfc2757d1f534ddc0, 0xdb6295993c439041, 0xfe5163abdebbc561,
    0xb7246e3a424dd2e0, 0x06492eea09d1921c, 0xfe1deb1cb129a73e, 0xe88235f52ebb4484, 0xe99c7026b45f7e41,
    0x3991d639835339f4, 0x9c845f8bbdf9283b, 0x1ff897ffde05980f, 0xef2f118b5a0a6d1f, 0x6d367ecf27cb09b7,
    0x4f463f669e5fea2d, 0x7527bac7ebe5f17b, 0x3d0739f78a5292ea, 0x6bfb5fb11f8d5d08, 0x56033046fc7b6bab};

__extension__ typedef unsigned __int128 u128;

/* 64 bits of 2/pi, from the one of weight 2^-from on (from >= -63) */
static uint64_t bits_of_two_over_pi(int from) {
    int word = (from + 63) / 64, shift = (from + 63) % 64;
    uint64_t high = two_over_pi[word] << shift;
    return shift ? high | two_over_pi[word + 1] >> (64 - shift) : high;
}

/* Reduce x > 0.5 of any size: x = quadrant * pi/2 + hi + lo (Payne and Hanek).
 *
 * x = m 2^e with an integer m. Bits of 2/pi whose product with x is a multiple of 4 are left out; of the others 192
 * enter: the fraction of x * 2/pi has 190 bits, of which at most some 62 are zeros at the front. */
static uint64_t reduce_far(double x, double *hi, double *lo) {
    uint64_t bits = bits_of(x);
    int e = (int)(bits >> 52) - 1075;
    if (e == 972) { /* infinity or NaN */
        *hi = *lo = NAN;
        return 0;
    }
    uint64_t m = (bits & 0xfffffffffffff) | 0x10000000000000;
    u128 low = (u128)m * bits_of_two_over_pi(e + 127);
    u128 middle = (u128)m * bits_of_two_over_pi(e + 63) + (uint64_t)(low >> 64);
    uint64_t top = m * bits_of_two_over_pi(e - 1) + (uint64_t)(middle >> 64);
    /* top has the quadrant in its two highest bits; the rest is the fraction, here rounded to the nearest quadrant */
    uint64_t quadrant = top >> 62;
    u128 fraction = ((u128)top << 64 | (uint64_t)middle) << 2 | (uint64_t)low >> 62;
    uint64_t end = (uint64_t)low << 2, negative = (uint64_t)(fraction >> 127);
    if (negative) {
        quadrant += 1;
        fraction = ~fraction;
        end = ~end;
    }
    int shift = 0;
    while (!(fraction >> 127) && shift < 100) {
        fraction = fraction << 1 | end >> 63;
        end <<= 1;
        shift += 1;
    }
    double scale = 1.0;
    while (shift-- > 0) scale *= 0.5;
    /* the 53 bits at the top and the 53 after them */
    double f_hi = (double)(uint64_t)(fraction >> 75) * 0x1p-53 * scale;
    double f_lo = (double)((uint64_t)(fraction >> 22) & 0x1fffffffffffff) * 0x1p-106 * scale;
    pair r = product((pair){all(f_hi), all(f_lo)}, (pair){all(0.5 * PI_HI), all(0.5 * PI_LO)});
    *hi = negative ? -r.hi[0] : r.hi[0];
    *lo = negative ? -r.lo[0] : r.lo[0];
    return quadrant;
}

static __attribute__((noinline)) void replace_far(const reals *x, const words *far, pair *r, words *quadrant) {
    for (int i = 0; i < AT_ONCE; i++) {
        double hi, lo;
        if (flagged((*far)[i])) {
            (*quadrant)[i] = reduce_far((*x)[i], &hi, &lo);
            r->hi[i] = hi;
            r->lo[i] = lo;
        }
    }
}

/* Reduce x >= 0: x = quadrant * pi/2 + hi + lo, |hi| <= pi/4 (Cody and Waite).
 *
 * The parts of pi/2 have 35, 35 and 53 bits; the products with the first two are exact. The error is below 2^-108,
 * which is small against hi unless hi is tiny. */
LANES pair reduce(reals x, words *quadrant) {
    reals k = x * 0x1.45f306dc9c883p-1 + ROUNDER, n = k - ROUNDER;
    pair t = ordered_sum(x - n * 0x1.921fb54440000p+0, -(n * 0x1.68c234c4c0000p-39));
    pair r = ordered_sum(t.hi, -(n * 0x1.98a2e03707345p-77));
    r.lo += t.lo;
    *quadrant = (words)k;
    words far = outside(x, 0.0, 1e5) | (outside(x, 0.0, 0.5) & outside(absolute(r.hi), 0x1p-16, 1.0));
    if (__builtin_expect(any(far), 0)) {
        pair rare = r;
        words rare_quadrant = *quadrant;
        replace_far(&x, &far, &rare, &rare_quadrant);
        *quadrant = rare_quadrant;
        return rare;
    }
    return r;
}

/* sin r and cos r, each as hi + lo with |lo| up to a tenth of hi */
LANES void sine_and_cosine(pair r, pair *sine, pair *cosine) {
    reals x = r.hi, z = x * x, z2 = z * z, half = 0.5 * z, w = 1.0 - half;
    /* (sin x - x) / x^3 in z = x^2 on |x| <= 0.7855, degree 5, error of sin x 2^-57.9 of it */
    reals s = (-0x1.5555555555548p-3 + z * 0x1.111111110f75bp-7) +
           z2 * ((-0x1.a01a019bf1ccep-13 + z * 0x1.71de355eb41b7p-19) +
                 z2 * (-0x1.ae5e54310e537p-26 + z * 0x1.5d8e2261dcff6p-33));
    /* (cos x - 1 + x^2/2) / x^4 in z on |x| <= 0.7855, degree 5, error of cos x 2^-63.8 of it */
    reals c = (0x1.555555555554ap-5 + z * -0x1.6c16c16c14e49p-10) +
           z2 * ((0x1.a01a019c68736p-16 + z * -0x1.27e4f7d8d8543p-22) +
                 z2 * (0x1.1ee9cca9d4da2p-29 + z * -0x1.8f9f5955c8258p-37));
    *sine = (pair){x, r.lo * w + x * z * s};
    *cosine = (pair){w, ((1.0 - w) - half) + (z2 * c - x * r.lo)};
}

/* sin(r + quadrant * pi/2), from sin r and cos r */
LANES reals turned_sine(pair s, pair c, words quadrant) {
    words odd = -(quadrant & 1);
    reals value = where(odd, c.hi, s.hi) + where(odd, c.lo, s.lo);
    return (reals)((words)value ^ (quadrant & 2) << 62);
}

LANES void turn_lanes(reals x, reals *sine, reals *cosine) {
    words quadrant;
    pair s, c, r = reduce(absolute(x), &quadrant);
    sine_and_cosine(r, &s, &c);
    *sine = times_sign(turned_sine(s, c, quadrant), x);
    *cosine = turned_sine(s, c, quadrant + 1);
}

LANES reals sin_lanes(reals x) {
    reals sine, cosine;
    turn_lanes(x, &sine, &cosine);
    return sine;
}

LANES reals cos_lanes(reals x) {
    reals sine, cosine;
    turn_lanes(x, &sine, &cosine);
    return cosine;
}

LANES reals tan_lanes(reals x) {
    words quadrant;
    pair s, c, r = reduce(absolute(x), &quadrant);
    sine_and_cosine(r, &s, &c);
    s = ordered_sum(s.hi, s.lo);
    c = ordered_sum(c.hi, c.lo);
    words odd = -(quadrant & 1);
    pair above = {where(odd, -c.hi, s.hi), where(odd, -c.lo, s.lo)};
    pair below = {where(odd, s.hi, c.hi), where(odd, s.lo, c.lo)};
    pair q = quotient(above, below);
    return times_sign(q.hi + q.lo, x);
}

/* ---- exp and hyperbolic functions ---- */

/* Reduce: x + low = n ln 2 + r, |r| <= 0.3466, and return sinh r = r.hi + *sinh_tail, cosh r = 1 + *cosh_tail.
 *
 * *k has n in its low bits. The first part of ln 2 has 40 bits, so that its product with n is exact. */
LANES reals reduced_exp(reals x, reals low, reals *k, reals *sinh_tail, reals *cosh_tail) {
    *k = x * 0x1.71547652b82fep+0 + ROUNDER;
    reals n = *k - ROUNDER;
    pair sum = ordered_sum(x - n * 0x1.62e42fefa2000p-1, low - n * 0x1.9ef35793c7673p-41);
    reals r = sum.hi, z = r * r, z2 = z * z;
    /* (sinh r - r) / r^3 in z = r^2 on |r| <= 0.3466, degree 4, error of sinh r 2^-61.7 of it */
    reals s = (0x1.5555555555559p-3 + z * 0x1.111111110f650p-7) +
           z2 * ((0x1.a01a01b006135p-13 + z * 0x1.71ddf808a7e87p-19) + z2 * 0x1.af5f374f70903p-26);
    /* (cosh r - 1 - r^2/2) / r^4 in z on |r| <= 0.3466, degree 4, error of cosh r 2^-70 */
    reals c = (0x1.5555555555558p-5 + z * 0x1.6c16c16c1500ap-10) +
           z2 * ((0x1.a01a01ad776e1p-16 + z * 0x1.27e4cc2642126p-22) + z2 * 0x1.1f8bb5f5f416ep-29);
    *sinh_tail = sum.lo + z * (r * s);
    *cosh_tail = z * (0.5 + z * c) + r * sum.lo;
    return r;
}

/* 2^(n + shift) for n as in reduced_exp, if that is a normal number */
LANES reals power_of_two(reals k, int shift) { return (reals)(((words)k + (uint64_t)(1023 + shift)) << 52); }

/* x 2^n for n as in reduced_exp, |n| < 2000, in two factors, of which only the second can overflow or round */
LANES reals times_power_of_two(reals x, reals k) {
    reals half = (k - ROUNDER) * 0.5 + ROUNDER, other = (k - half) + ROUNDER;
    return x * power_of_two(half, 0) * power_of_two(other, 0);
}

/* exp(x + low) / 2^n for n as in reduced_exp */
LANES reals exp_without_power(reals x, reals low, reals *k) {
    reals sinh_tail, cosh_tail, r = reduced_exp(x, low, k, &sinh_tail, &cosh_tail);
    pair w = ordered_sum(all(1.0), r);
    return w.hi + (w.lo + (sinh_tail + cosh_tail));
}

/* exp(x + low) where 2^n may be no normal number */
static double exp_of_far(double x, double low) {
    if (x != x) return NAN;
    if (x > 711.0) return INFINITY;
    if (x < -750.0) return 0.0;
    reals k, value = exp_without_power(all(x), all(low), &k);
    return times_power_of_two(value, k)[0];
}

/* exp(x + low) */
LANES reals exp_of_sum(reals x, reals low) {
    reals k, value = exp_without_power(x, low, &k);
    value *= power_of_two(k, 0);
    words far = outside(absolute(x), 0.0, 708.0);
    return with_others(value, far, exp_of_far, x, low);
}

LANES reals exp_lanes(reals x) { return exp_of_sum(x, all(0.0)); }

LANES reals expm1_lanes(reals x) {
    reals k, sinh_tail, cosh_tail, near = at_least(at_most(x, 710.0), -50.0);
    reals r = reduced_exp(near, all(0.0), &k, &sinh_tail, &cosh_tail);
    reals scale = power_of_two(k, -1); /* half of 2^n, as 2^1024 is no float64 */
    pair less = exact_sum(scale, all(-0.5));
    pair w = ordered_sum(less.hi, scale * r);
    reals value = 2.0 * (w.hi + (w.lo + (less.lo + scale * (sinh_tail + cosh_tail))));
    return where((words)(absolute(x) < 0x1p-54), x, value);
}

/* sinh(a)/2 and cosh(a)/2 for 0 <= a <= 710.6, each as hi + lo with a small lo */
LANES void half_hyperbolic(reals a, pair *sine, pair *cosine) {
    reals k, sinh_tail, cosh_tail;
    reals r = reduced_exp(a, all(0.0), &k, &sinh_tail, &cosh_tail);
    reals up = power_of_two(k, -2); /* and 2^(-n - 2), which is nothing beside it from 40 on */
    reals down = (reals)(((uint64_t)1021 - (words)k) << 52 & (words)(a < 40.0));
    pair p = ordered_sum(up, down), q = ordered_sum(up, -down); /* cosh(n ln 2)/2 and sinh(n ln 2)/2 */
    /* the large parts, q + (up + down) r and p + (up - down) r, whose products are exact */
    pair s = ordered_sum(q.hi, up * r), c = ordered_sum(p.hi, up * r);
    pair t = ordered_sum(s.hi, down * r), d = ordered_sum(c.hi, -(down * r));
    *sine = (pair){t.hi, (t.lo + s.lo) + (q.lo + (q.hi * cosh_tail + p.hi * sinh_tail))};
    *cosine = (pair){d.hi, (d.lo + c.lo) + (p.lo + (p.hi * cosh_tail + q.hi * sinh_tail))};
}

LANES reals sinh_lanes(reals x) {
    pair s, c;
    half_hyperbolic(at_most(absolute(x), 710.6), &s, &c);
    return where((words)(absolute(x) < 0x1p-28), x, signed_as(2.0 * (s.hi + s.lo), x));
}

LANES reals cosh_lanes(reals x) {
    pair s, c;
    half_hyperbolic(at_most(absolute(x), 710.6), &s, &c);
    return 2.0 * (c.hi + c.lo);
}

LANES reals tanh_lanes(reals x) {
    pair s, c;
    half_hyperbolic(at_most(absolute(x), 22.0), &s, &c);
    pair q = quotient(ordered_sum(s.hi, s.lo), ordered_sum(c.hi, c.lo));
    return where((words)(absolute(x) < 0x1p-28), x, signed_as(q.hi + q.lo, x));
}

/* ---- log and what is a logarithm ---- */

/* m in [sqrt(1/2), sqrt(2)) and e with x = m 2^e, for a normal x > 0 */
LANES reals mantissa(reals x, reals *e) {
    words biased = ((words)x - 0x3fe6a09e667f3bcdu + ONE_EXPONENT) >> 52;
    *e = (reals)(biased | 0x4330000000000000u) - (0x1p52 + 1023.0);
    return (reals)((words)x - (biased << 52) + ONE_EXPONENT);
}

/* log(y) + shift ln 2 + low for a normal y > 0 */
LANES reals shifted_log(reals y, reals shift, reals low) {
    reals e, f = mantissa(y, &e) - 1.0;
    e += shift;
    reals s = f / (2.0 + f), z = s * s, z2 = z * z, half = 0.5 * f * f;
    /* (log(1 + f) - 2s) / s^3, s = f / (2 + f), in z = s^2, |s| <= 0.1716, degree 6, error of the log 2^-59.4 of it */
    reals p = (0x1.5555555555594p-1 + z * 0x1.999999997f73fp-2) +
           z2 * ((0x1.249249423ac8ep-2 + z * 0x1.c71c51d6d58b3p-3) +
                 z2 * ((0x1.746647f20ba3ap-3 + z * 0x1.39a0ead03ef44p-3) + z2 * 0x1.2f0cce60603fap-3));
    /* log(1 + f) = f - f^2/2 + s (f^2/2 + z p); the first two terms and e ln 2 are added exactly */
    pair w = ordered_sum(e * 0x1.62e42fefa2000p-1, f);
    pair v = ordered_sum(w.hi, -half);
    return v.hi + ((v.lo + w.lo) + ((e * 0x1.9ef35793c7673p-41 + low) + s * (half + z * p)));
}

static double log_of_other(double x, double unused) {
    (void)unused;
    if (x > 0.0 && x < INFINITY) return shifted_log(all(x * 0x1p54), all(-54.0), all(0.0))[0];
    return x == 0.0 ? -INFINITY : x < 0.0 ? NAN : x;
}

LANES reals log_lanes(reals x) {
    words other = outside(x, SMALLEST_NORMAL, LARGEST);
    return with_others(shifted_log(x, all(0.0), all(0.0)), other, log_of_other, x, x);
}

/* log(y.hi + y.lo) + shift ln 2 */
LANES reals log_of_pair(pair y, reals shift) { return shifted_log(y.hi, shift, y.lo / y.hi); }

LANES reals log1p_lanes(reals x) {
    reals value = log_of_pair(exact_sum(all(1.0), x), all(0.0));
    value = where((words)(absolute(x) < 0x1p-54) | ~(words)(x < INFINITY), x, value);
    return where((words)(x <= -1.0), where((words)(x == -1.0), all(-INFINITY), all(NAN)), value);
}

/* log(x + sqrt(x^2 + square)) for square = 1 or -1 and x >= 0, x^2 >= -square; from 2^30 on it is log(2 x) */
LANES reals inverse_hyperbolic(reals x, double square) {
    words large = (words)(x > 0x1p30);
    reals a = at_most(x, 0x1p30);
    pair p = exact_product(a, a), s = exact_sum(p.hi, all(square));
    pair h = root(ordered_sum(s.hi, s.lo + p.lo)), y = exact_sum(a, h.hi);
    y.lo += h.lo;
    y = (pair){where(large, x, y.hi), where(large, all(0.0), y.lo)};
    return where((words)(x < INFINITY), log_of_pair(y, where(large, all(1.0), all(0.0))), x);
}

LANES reals asinh_lanes(reals x) {
    reals a = absolute(x);
    return where((words)(a < 0x1p-28), x, signed_as(inverse_hyperbolic(a, 1.0), x));
}

LANES reals acosh_lanes(reals x) { return where((words)(x < 1.0), all(NAN), inverse_hyperbolic(x, -1.0)); }

LANES reals atanh_lanes(reals x) {
    reals a = absolute(x);
    pair y = quotient(ordered_sum(all(1.0), a), ordered_sum(all(1.0), -a));
    reals value = where((words)(a == 1.0), all(INFINITY), 0.5 * log_of_pair(y, all(0.0)));
    return where((words)(a < 0x1p-28), x, where((words)(a > 1.0), all(NAN), signed_as(value, x)));
}

/* ---- pow ---- */

/* log(x) + shift ln 2 to 2^-68 of it, for a normal x > 0 */
LANES pair precise_log(reals x, reals shift) {
    reals e, f = mantissa(x, &e) - 1.0;
    e += shift;
    pair s = quotient((pair){f, all(0.0)}, exact_sum(all(2.0), f)), z = product(s, s), cube = product(z, s);
    reals u = z.hi, u2 = u * u;
    /* (log(1 + f) - 2s - 2/3 s^3 - 2/5 s^5) / s^7 in z = s^2 on |s| <= 0.1716, degree 6, error of the log 2^-72.7 */
    reals p = (0x1.24924924927fdp-2 + u * 0x1.c71c71c651df0p-3) +
           u2 * ((0x1.745d17dbd0fe7p-3 + u * 0x1.3b1376f9cfe99p-3) +
                 u2 * ((0x1.111dfdbefdf8ep-3 + u * 0x1.de97248a13f7bp-4) + u2 * 0x1.e81b928ce3cb6p-4));
    pair c = ordered_sum(all(0x1.999999999999ap-2), u * p - 0x1.999999999999ap-56); /* 2/5 + ... */
    c = product(c, z);
    c = (pair){c.hi, c.lo + 0x1.5555555555555p-55};
    pair d = ordered_sum(all(0x1.5555555555555p-1), c.hi); /* 2/3 + ... */
    d = product((pair){d.hi, d.lo + c.lo}, cube);
    pair sum = ordered_sum(2.0 * s.hi, d.hi);
    reals low = (sum.lo + d.lo) + 2.0 * s.lo;
    pair w = ordered_sum(e * 0x1.62e42fefa2000p-1, sum.hi);
    return ordered_sum(w.hi, w.lo + (low + e * 0x1.9ef35793c7673p-41));
}

/* (x 2^shift)^y for a normal x > 0 and |y| <= 2^64 */
LANES reals positive_pow(reals x, reals y, reals shift) {
    pair log_x = precise_log(x, shift), p = exact_product(y, log_x.hi);
    return exp_of_sum(p.hi, p.lo + y * log_x.lo);
}

/* The cases of annex F of C99, and bases that are subnormal or negative. */
static double pow_of_other(double x, double y) {
    if (y == 0.0 || x == 1.0) return 1.0;
    if (x != x || y != y) return NAN;
    double a = __builtin_fabs(x), b = __builtin_fabs(y);
    int whole = b >= 0x1p53 || b == (double)(int64_t)b;
    int odd = b < 0x1p53 && whole && ((int64_t)b & 1);
    int minus = __builtin_signbit(x) && odd;
    double size;
    if (b == INFINITY)
        size = a == 1.0 ? 1.0 : (a > 1.0) == (y > 0.0) ? INFINITY : 0.0;
    else if (a == 0.0 || a == INFINITY)
        size = (a == 0.0) == (y < 0.0) ? INFINITY : 0.0;
    else if (x < 0.0 && !whole)
        return NAN;
    else {
        double shift = a < SMALLEST_NORMAL ? 54.0 : 0.0;
        if (b > 0x1p64) y = y > 0.0 ? 0x1p64 : -0x1p64; /* the result is 0, 1 or infinite as for y */
        size = positive_pow(all(shift > 0.0 ? a * 0x1p54 : a), all(y), all(-shift))[0];
    }
    return minus ? -size : size;
}

LANES reals pow_lanes(reals x, reals y) {
    words other = outside(x, SMALLEST_NORMAL, LARGEST) | outside(absolute(y), 0.0, 0x1p64);
    return with_others(positive_pow(x, y, all(0.0)), other, pow_of_other, x, y);
}

/* ---- atan and what is an angle ---- */

/* The angle of the point (x, y) in the first quadrant, neither coordinate infinite, as hi + lo.
 *
 * It is the angle of slope c, one of 0, 1/2, 1, 2 or infinity, and atan t, t = (y - c x) / (x + c y), |t| < 0.2361. */
LANES pair angle(pair y, pair x) {
    words steep = (words)(y.hi > 4.2360679 * x.hi);
    pair a = {where(steep, -x.hi, y.hi), where(steep, -x.lo, y.lo)};
    pair b = {where(steep, y.hi, x.hi), where(steep, y.lo, x.lo)};
    words from_half = (words)(a.hi > 0.2360679 * b.hi), from_one = (words)(a.hi > 0.7207592 * b.hi);
    words from_two = (words)(a.hi > 1.3874258 * b.hi);
    reals c = where(from_two, all(2.0), where(from_one, all(1.0), where(from_half, all(0.5), all(0.0))));
    reals hi = where(from_half, all(0x1.dac670561bb4fp-2), where(steep, all(0.5 * PI_HI), all(0.0)));
    reals lo = where(from_half, all(0x1.a2b7f222f65e2p-56), where(steep, all(0.5 * PI_LO), all(0.0)));
    hi = where(from_two, all(0x1.1b6e192ebbe44p+0), where(from_one, all(0.25 * PI_HI), hi));
    lo = where(from_two, all(0x1.b1b466a88828ep-54), where(from_one, all(0.25 * PI_LO), lo));
    pair above = exact_sum(a.hi, -c * b.hi), below = exact_sum(b.hi, c * a.hi);
    above.lo += a.lo - c * b.lo;
    below.lo += b.lo + c * a.lo;
    pair t = quotient(above, below);
    reals z = t.hi * t.hi, z2 = z * z, z4 = z2 * z2;
    /* (atan t - t) / t^3 in z = t^2 on |t| <= 0.23608, degree 7, error of atan t 2^-58.9 of it */
    reals p = ((-0x1.5555555555518p-2 + z * 0x1.999999998861bp-3) +
            z2 * (-0x1.24924917404bdp-3 + z * 0x1.c71c67c3d8e8fp-4)) +
           z4 * ((-0x1.745b0016cc546p-4 + z * 0x1.3ad239c1018c0p-4) +
                 z2 * (-0x1.0c6088f56ffadp-4 + z * 0x1.8350f0ff17d4ap-5));
    pair w = ordered_sum(hi, t.hi);
    return (pair){w.hi, w.lo + (lo + (t.lo + t.hi * z * p))};
}

/* The angle, or pi - angle where mirrored. */
LANES reals mirrored_angle(pair t, words mirrored) {
    pair left = ordered_sum(all(PI_HI), -t.hi);
    return where(mirrored, left.hi + (left.lo + (PI_LO - t.lo)), t.hi + t.lo);
}

LANES reals atan_lanes(reals x) {
    pair t = angle((pair){at_most(absolute(x), 0x1p100), all(0.0)}, (pair){all(1.0), all(0.0)});
    return where((words)(absolute(x) < 0x1p-28), x, signed_as(t.hi + t.lo, x));
}

/* sqrt(1 - a^2) */
LANES pair other_leg(reals a) {
    pair p = exact_product(a, a), s = ordered_sum(all(1.0), -p.hi);
    return root(ordered_sum(s.hi, s.lo - p.lo));
}

LANES reals asin_lanes(reals x) {
    reals a = absolute(x);
    pair t = angle((pair){a, all(0.0)}, other_leg(a));
    return where((words)(a < 0x1p-28), x, signed_as(t.hi + t.lo, x));
}

LANES reals acos_lanes(reals x) {
    reals a = absolute(x);
    return mirrored_angle(angle(other_leg(a), (pair){a, all(0.0)}), (words)(x < 0.0));
}

LANES reals finite_atan2(reals y, reals x) {
    pair t = angle((pair){absolute(y), all(0.0)}, (pair){absolute(x), all(0.0)});
    return signed_as(mirrored_angle(t, (words)(x < 0.0)), y);
}

/* The cases of annex F of C99, and coordinates so large, small or different that their products leave the range. */
static double atan2_of_other(double y, double x) {
    if (x != x || y != y) return NAN;
    double a = __builtin_fabs(y), b = __builtin_fabs(x), size;
    int left = __builtin_signbit(x) != 0;
    if (a == INFINITY && b == INFINITY)
        size = left ? 0.75 * PI_HI : 0.25 * PI_HI;
    else if (a == 0.0 || b == INFINITY || a < 0x1p-100 * b)
        size = left ? PI_HI : a == 0.0 ? 0.0 : a / b;
    else if (b == 0.0 || a == INFINITY || b < 0x1p-100 * a)
        size = 0.5 * PI_HI;
    else {
        double scale = a > 1.0 ? 0x1p-500 : 0x1p500;
        return finite_atan2(all(y * scale), all(x * scale))[0];
    }
    return __builtin_signbit(y) ? -size : size;
}

LANES reals atan2_lanes(reals y, reals x) {
    words other = outside(absolute(x), 0x1p-300, 0x1p300) | outside(absolute(y), 0x1p-300, 0x1p300);
    return with_others(finite_atan2(y, x), other, atan2_of_other, y, x);
}

/* ---- erf, erfc ---- */

/* (1 + 2a) exp(a^2) erfc(a) = 1.2375... + t (scaled_erfc[0] + scaled_erfc[1] t + ...), t = (a - 3.75) / (a + 3.75), on
 * 0 <= a <= 28, degree 24, error 2^-60.1 of it */
static const double scaled_erfc[24] = {
    -0x1.1f367683f89a6p-3,  0x1.d5f2948159c81p-9,   0x1.510169d096742p-4,  -0x1.bda9309a28744p-4,
    0x1.7a14188a9b62bp-4,   -0x1.e0d0fa6e04e5ap-5,  0x1.d0b0037d5622ap-6,  -0x1.3f603c32f3521p-7,
    0x1.cc3a0e6d018e6p-10,  0x1.33fb23e6207b7p-12,  -0x1.303fa4fc7f85bp-12, 0x1.b144505112fe0p-15,
    0x1.778c16dd4602fp-16,  -0x1.800823f7729bep-17, -0x1.057b2ca089a27p-20, 0x1.d69b428218f26p-20,
    -0x1.e0c6876003e08p-25, -0x1.175b8ef23d545p-22, 0x1.72d5faf63ee6fp-26, 0x1.5237934a9fb97p-25,
    -0x1.59edf3c28d8cfp-29, -0x1.60bb3e7e262b0p-28, -0x1.2f19b4fec9a08p-34, 0x1.4ef4d576ffff5p-32};

/* (erf x)/x - 1 = small_erf[0] + small_erf[1] z + ..., z = x^2, on |x| <= 0.5, degree 9, error 2^-63.2 */
static const double small_erf[10] = {
    0x1.06eba8214db69p-3,   -0x1.812746b0379e6p-2, 0x1.ce2f21a042a84p-4,   -0x1.b82ce312796f7p-6,
    0x1.565bcd08deb1cp-8,   -0x1.c02db1a3d5757p-11, 0x1.f9a287aef9050p-14, -0x1.f4b8022722d41p-17,
    0x1.b73b1973684cbp-20,  -0x1.386567ce588e3p-23};

LANES reals polynomial(const double *c, int terms, reals x) {
    reals p = all(c[terms - 1]);
    for (int i = terms - 2; i >= 0; i--) p = p * x + c[i];
    return p;
}

/* erfc(a) 2^-n for 0 <= a <= 28, with n in the low bits of *k: exp(-a^2) times the polynomial over 1 + 2a */
LANES pair erfc_without_power(reals a, reals *k) {
    pair square = exact_product(a, a);
    reals sinh_tail, cosh_tail, r = reduced_exp(-square.hi, -square.lo, k, &sinh_tail, &cosh_tail);
    pair w = ordered_sum(all(1.0), r);
    w = ordered_sum(w.hi, w.lo + (sinh_tail + cosh_tail));
    reals t = (a - 3.75) / (a + 3.75);
    pair p = ordered_sum(all(0x1.3ccda0b5d5dc2p+0), t * polynomial(scaled_erfc, 24, t));
    p.lo += 0x1.e6ffec1f1ab1fp-54;
    return product(w, quotient(p, exact_sum(all(1.0), 2.0 * a)));
}

LANES reals erfc_lanes(reals x) {
    reals k, a = at_most(absolute(x), 28.0);
    pair size = erfc_without_power(a, &k);
    pair left = ordered_sum(all(2.0), -times_power_of_two(size.hi, k));
    left.lo -= times_power_of_two(size.lo, k);
    reals far = where((words)(x < 0.0), left.hi + left.lo, times_power_of_two(size.hi + size.lo, k));
    pair near = ordered_sum(all(1.0), -x);
    return where((words)(a < 0.5), near.hi + (near.lo - x * polynomial(small_erf, 10, x * x)), far);
}

LANES reals erf_lanes(reals x) {
    reals k, a = at_most(absolute(x), 6.0);
    pair rest = erfc_without_power(a, &k);
    reals scale = power_of_two(k, 0);
    pair size = ordered_sum(all(1.0), -(rest.hi * scale));
    reals near = x + x * polynomial(small_erf, 10, x * x);
    return where((words)(a < 0.5), near, signed_as(size.hi + (size.lo - rest.lo * scale), x));
}

/* ---- rows ---- */

void hamsym_sin(const double *x, double *out, long n) { map(sin_lanes, x, out, n); }
void hamsym_cos(const double *x, double *out, long n) { map(cos_lanes, x, out, n); }
void hamsym_sin_cos(const double *x, double *sine, double *cosine, long n) {
    for (long i = 0; i < n; i += AT_ONCE) {
        reals s, c;
        turn_lanes(load(x + i), &s, &c);
        memcpy(sine + i, &s, sizeof s);
        memcpy(cosine + i, &c, sizeof c);
    }
}
void hamsym_tan(const double *x, double *out, long n) { map(tan_lanes, x, out, n); }
void hamsym_exp(const double *x, double *out, long n) { map(exp_lanes, x, out, n); }
void hamsym_expm1(const double *x, double *out, long n) { map(expm1_lanes, x, out, n); }
void hamsym_log(const double *x, double *out, long n) { map(log_lanes, x, out, n); }
void hamsym_log1p(const double *x, double *out, long n) { map(log1p_lanes, x, out, n); }
void hamsym_asin(const double *x, double *out, long n) { map(asin_lanes, x, out, n); }
void hamsym_acos(const double *x, double *out, long n) { map(acos_lanes, x, out, n); }
void hamsym_atan(const double *x, double *out, long n) { map(atan_lanes, x, out, n); }
void hamsym_sinh(const double *x, double *out, long n) { map(sinh_lanes, x, out, n); }
void hamsym_cosh(const double *x, double *out, long n) { map(cosh_lanes, x, out, n); }
void hamsym_tanh(const double *x, double *out, long n) { map(tanh_lanes, x, out, n); }
void hamsym_asinh(const double *x, double *out, long n) { map(asinh_lanes, x, out, n); }
void hamsym_acosh(const double *x, double *out, long n) { map(acosh_lanes, x, out, n); }
void hamsym_atanh(const double *x, double *out, long n) { map(atanh_lanes, x, out, n); }
void hamsym_erf(const double *x, double *out, long n) { map(erf_lanes, x, out, n); }
void hamsym_erfc(const double *x, double *out, long n) { map(erfc_lanes, x, out, n); }
void hamsym_pow(const double *x, const double *y, double *out, long n) { map_two(pow_lanes, x, y, out, n); }
void hamsym_atan2(const double *y, const double *x, double *out, long n) { map_two(atan2_lanes, y, x, out, n); }
