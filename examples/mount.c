/* A body on a rubber mount: responses, a branch with stability, a motion with memory, its spectrum.
   cc mount.c $(pkg-config --cflags --libs viscovib) -o mount */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <viscovib.h>

enum { n_nu = 5, n_signal = 256 };

/* End with the message of a call that failed. */
static void check(int status) {
  if (status == VISCOVIB_OK) return;
  fprintf(stderr, "viscovib: %s\n", viscovib_message());
  exit(status);
}

/* A column of the first table by its name. */
static const double *column(const viscovib_result *result, const char *name) {
  return viscovib_column(result, 0, viscovib_find_column(result, 0, name));
}

int main(void) {
  const double mass[] = {1.0, 0.0, 0.0, 2.0}, stiffness[] = {30.0, -10.0, -10.0, 10.0};
  const double nu[n_nu] = {1.0, 1.5, 2.0, 3.0, 6.0};
  double signal[n_signal], real[n_signal / 2 + 1], imaginary[n_signal / 2 + 1];
  const double *x, *y, *p, *growing;
  viscovib_system *system;
  viscovib_result *result;
  int i, n, most = 0;

  if (viscovib_interface() != VISCOVIB_INTERFACE) {
    fprintf(stderr, "this program is for interface %d\n", VISCOVIB_INTERFACE);
    return 1;
  }

  /* Two masses; the second has a hardening spring with memory. */
  check(viscovib_system_new(2, mass, NULL, stiffness, &system));
  check(viscovib_system_add(system, "kernel",
                            "kind = 'rabotnov', amplitude = 0.2, alpha = 0.6, beta = 1"));
  check(viscovib_system_add(system, "spring", "stiffness = 0 0 0 5, kernel = 1"));
  check(viscovib_system_add(system, "force", "on = 'x2', law = '4*x2^3', kernel = 1"));
  check(viscovib_system_add(system, "load", "on = 'x2', amplitude = 2"));

  check(viscovib_response(system, "linear", n_nu, nu, NULL, &result));
  x = column(result, "x2_1_re");
  y = column(result, "x2_1_im");
  printf("linear response of x2:");
  for (i = 0; i < n_nu; i++) printf(" %.6f", hypot(x[i], y[i]));
  printf("\n");
  viscovib_result_free(result);

  check(viscovib_response(system, "newton", n_nu, nu, "harmonics = 7", &result));
  x = column(result, "x2_1_re");
  y = column(result, "x2_1_im");
  printf("nonlinear response of x2:");
  for (i = 0; i < n_nu; i++)
    printf(" %.6f (%s)", hypot(x[i], y[i]),
           viscovib_word(result, 0, viscovib_find_column(result, 0, "outcome"), i));
  printf("\n");
  viscovib_result_free(result);

  check(viscovib_branch(system, 1.0, 8.0, "tolerance = 1e-8", &result));
  p = column(result, "nu");
  growing = column(result, "growing");
  n = viscovib_rows(result, 0);
  for (i = 0; i < n; i++) if (growing[i] > most) most = (int)growing[i];
  printf("branch: %s; from %g to %g, at most %d perturbations grow\n", viscovib_summary(result), p[0],
         p[n - 1], most);
  viscovib_result_free(result);

  /* The motion ends with 8 periods of the load in 256 steps. */
  check(viscovib_motion(system, 3.0, 40.0 * 2.0 * 3.14159265358979323846 / 3.0, NULL,
                        "dt = 0.06544984694978735", &result));
  n = viscovib_rows(result, 0);
  x = column(result, "x2");
  for (i = 0; i < n_signal; i++) signal[i] = x[n - n_signal + i];
  printf("motion: %s; x2 at its end %.6f\n", viscovib_summary(result), x[n - 1]);
  viscovib_result_free(result);

  check(viscovib_spectrum(n_signal, signal, VISCOVIB_HANN, real, imaginary));
  printf("spectrum of x2 at the load: %.4f\n", hypot(real[8], imaginary[8]));

  /* A wrong call returns an error and changes nothing. */
  if (viscovib_system_add(system, "load", "on = 'x3', amplitude = 1") != VISCOVIB_OK)
    printf("refused: %s\n", viscovib_message());
  viscovib_system_free(system);
  return 0;
}
