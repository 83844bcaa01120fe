/* Features that Fortran compilers lack or implement differently: functions in quadruple precision
   and the mode of subnormal numbers. */
#define _GNU_SOURCE
#include <math.h>

/* Without 128-bit functions in the C library, use its widest type. */
#if defined(__GLIBC__) && defined(__HAVE_FLOAT128) && __HAVE_FLOAT128
typedef _Float128 wide;
#define wide_fmod fmodf128
#define wide_gamma tgammaf128
#define wide_turn 6.28318530717958647692528676655900577f128
#else
typedef long double wide;
#define wide_fmod fmodl
#define wide_gamma tgammal
#define wide_turn 6.28318530717958647692528676655900577L
#endif

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

/* Gamma(x), correctly rounded except for rare ties. The C library's double version has errors of
   several ulp. */
double viscovib_gamma(double x) { return (double)wide_gamma((wide)x); }

/* frequency*time modulo 2 pi, in [0, 2 pi), in two parts. */
void viscovib_split_phase(double frequency, double time, double *high, double *low) {
  wide exact;
  *high = *low = 0.0;
  if (frequency == 0.0 || time == 0.0) return;
  exact = wide_fmod((wide)frequency * (wide)time, wide_turn);
  if (exact < 0) exact += wide_turn;
  *high = (double)exact;
  *low = (double)(exact - (wide)*high);
}

/* Flush results below the smallest normal number to 0. Returns the previous mode. */
unsigned viscovib_flush_subnormals(void) {
#if defined(__SSE2__)
  unsigned before = _mm_getcsr();
  _mm_setcsr(before | 0x8000u);
  return before;
#else
  return 0;
#endif
}

/* Restore the mode of subnormal numbers. Other modes and exception flags are unchanged. */
void viscovib_restore_subnormals(unsigned before) {
#if defined(__SSE2__)
  _mm_setcsr((_mm_getcsr() & ~0x8000u) | (before & 0x8000u));
#else
  (void)before;
#endif
}
