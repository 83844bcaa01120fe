/* Force laws that are compiled functions of numbers, double f(double, ...). */
#include <stddef.h>
#include <stdint.h>

typedef double f1(double), f2(double, double), f3(double, double, double),
  f4(double, double, double, double), f5(double, double, double, double, double),
  f6(double, double, double, double, double, double),
  f7(double, double, double, double, double, double, double),
  f8(double, double, double, double, double, double, double, double);

/* Values of a function of m operands at n samples, x of shape (m, n). */
static void apply(void (*f)(void), int n, int m, const double *x, double *value) {
#define X(j) x[(size_t)(j) * n + k]
  for (int k = 0; k < n; k++) switch (m) {
      case 1: value[k] = ((f1 *)f)(X(0)); break;
      case 2: value[k] = ((f2 *)f)(X(0), X(1)); break;
      case 3: value[k] = ((f3 *)f)(X(0), X(1), X(2)); break;
      case 4: value[k] = ((f4 *)f)(X(0), X(1), X(2), X(3)); break;
      case 5: value[k] = ((f5 *)f)(X(0), X(1), X(2), X(3), X(4)); break;
      case 6: value[k] = ((f6 *)f)(X(0), X(1), X(2), X(3), X(4), X(5)); break;
      case 7: value[k] = ((f7 *)f)(X(0), X(1), X(2), X(3), X(4), X(5), X(6)); break;
      case 8: value[k] = ((f8 *)f)(X(0), X(1), X(2), X(3), X(4), X(5), X(6), X(7)); break;
    }
#undef X
}

/* Values at n samples of m operands, and derivatives if `wanted` is 1. At the address `table` are
   the function and its derivatives by each operand, NULL for parameters. */
void viscovib_compiled_law(int64_t table, int n, int m, int wanted, const double *x, double *value,
                           double *by) {
  void (**f)(void) = (void (**)(void))(intptr_t)table;

  apply(f[0], n, m, x, value);
  for (int j = 0; wanted && j < m; j++)
    if (f[j + 1]) apply(f[j + 1], n, m, x, by + (size_t)j * n);
}
