/* The instruction level of the processor, and whether its arithmetic is that of IEEE 754. */

#include <float.h>
#include <math.h>

#define EXPORTED __attribute__((visibility("default")))

EXPORTED int hamsym_level(void);
EXPORTED int hamsym_arithmetic(void);

#if defined(__x86_64__)
#include <cpuid.h>

/* Bits of leaves 1 (ecx), 7 (ebx) and 0x80000001 (ecx) of cpuid, and of the registers that the
   operating system saves: those of AVX, and those of AVX-512. */
#define V2 (bit_SSE3 | bit_SSSE3 | bit_CMPXCHG16B | bit_SSE4_1 | bit_SSE4_2 | bit_POPCNT)
#define V3 (bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C)
#define V3_OF_7 (bit_AVX2 | bit_BMI | bit_BMI2)
#define V3_EXTENDED bit_LZCNT
#define V3_SAVED 0x06u
#define V4_OF_7 (bit_AVX512F | bit_AVX512DQ | bit_AVX512CD | bit_AVX512BW | bit_AVX512VL)
#define V4_SAVED 0xe6u

static int has(unsigned found, unsigned wanted) { return (found & wanted) == wanted; }

/* 2, 3 or 4: the highest level x86-64-v2, -v3, -v4 that this processor and its operating system
   have; 1 below that. Not by __builtin_cpu_supports, which finds no feature when zig compiles it. */
int hamsym_level(void) {
    unsigned eax, ebx, ecx, edx, saved, upper;
    if (!__get_cpuid(1, &eax, &ebx, &ecx, &edx) || !has(ecx, V2))
        return 1;
    if (!has(ecx, V3))
        return 2;
    __asm__ volatile("xgetbv" : "=a"(saved), "=d"(upper) : "c"(0));
    if (!has(saved, V3_SAVED) || !__get_cpuid(0x80000001, &eax, &ebx, &ecx, &edx) ||
        !has(ecx, V3_EXTENDED))
        return 2;
    if (!__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx) || !has(ebx, V3_OF_7))
        return 2;
    return has(ebx, V4_OF_7) && has(saved, V4_SAVED) ? 4 : 3;
}
#else
/* 0: this architecture has one library for all its processors. */
int hamsym_level(void) { return 0; }
#endif

/* 0, or the number of the first thing that the arithmetic of this thread lacks: 1 rounding to
   nearest, 2 subnormal numbers, 3 operations rounded one by one, 4 fused multiply-add.
   Operands are volatile, so that the compiler does not compute the results. */
int hamsym_arithmetic(void) {
    volatile double one = 1.0, minus_one = -1.0, next = 1.0 + DBL_EPSILON;
    volatile double low = 0.25 * DBL_EPSILON, high = 0.75 * DBL_EPSILON;
    if (one + low != one || minus_one - low != minus_one || one + high != next)
        return 1;
    volatile double least = DBL_MIN, half = 0.5, two = 2.0;
    volatile double subnormal = least * half;
    if (subnormal == 0.0 || subnormal * two != least)
        return 2;
    /* Just above a tie, which extended precision makes a tie; a product whose error a contraction
       into a fused operation would leave. */
    volatile double above = DBL_EPSILON * (0.5 + 0x1p-22), square = 1.0 + 2.0 * DBL_EPSILON;
    /* 1/3 is rounded down, 1/10 and the root of 2 are rounded up. */
    volatile double three = 3.0, ten = 10.0;
    if (one + above != next || next * next - square != 0.0 || one / three != 0x1.5555555555555p-2 ||
        one / ten != 0x1.999999999999ap-4 || sqrt(two) != 0x1.6a09e667f3bcdp+0)
        return 3;
    if (fma(next, next, -square) != DBL_EPSILON * DBL_EPSILON)
        return 4;
    return 0;
}
