/* Reference values in the most accurate type of the C library. */
#define _GNU_SOURCE
#include <math.h>

#if defined(__GLIBC__) && defined(__HAVE_FLOAT128) && __HAVE_FLOAT128
typedef _Float128 wide;
#define wide_sin sinf128
#define wide_cos cosf128
#else
typedef long double wide;
#define wide_sin sinl
#define wide_cos cosl
#endif

double exact_sine(double x) { return (double)wide_sin((wide)x); }

/* Cosine of p (start + h (n + c)). */
double exact_cosine(double p, double start, double h, double n, double c) {
  return (double)wide_cos((wide)p * ((wide)start + (wide)h * ((wide)n + (wide)c)));
}
