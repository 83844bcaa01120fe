/* Transforms by FFTW (-Dfft=fftw); fft_own.c has the same interface. Estimated plans, so that
   results do not vary from run to run. */
#include <complex.h>
#include <fftw3.h>

/* One axis of length n; accepts any arrays, and does not change the signal. */
fftw_plan viscovib_plan_line(int n, double *signal, fftw_complex *spectrum) {
  return fftw_plan_dft_r2c_1d(n, signal, spectrum,
                              FFTW_ESTIMATE | FFTW_UNALIGNED | FFTW_PRESERVE_INPUT);
}

/* Three axes, the last contiguous; arrays must have the same alignment as these. */
fftw_plan viscovib_plan_box(int n_1, int n_2, int n_3, double *u, fftw_complex *c) {
  return fftw_plan_dft_r2c_3d(n_1, n_2, n_3, u, c, FFTW_ESTIMATE);
}

/* Inverse transform; the coefficients are overwritten. */
fftw_plan viscovib_plan_box_back(int n_1, int n_2, int n_3, fftw_complex *c, double *u) {
  return fftw_plan_dft_c2r_3d(n_1, n_2, n_3, c, u, FFTW_ESTIMATE);
}

void viscovib_transform(fftw_plan plan, double *u, fftw_complex *c) {
  fftw_execute_dft_r2c(plan, u, c);
}

void viscovib_transform_back(fftw_plan plan, fftw_complex *c, double *u) {
  fftw_execute_dft_c2r(plan, c, u);
}

void viscovib_free_plan(fftw_plan plan) { fftw_destroy_plan(plan); }
