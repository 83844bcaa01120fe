/* Transforms without a library (-Dfft=own), for packages of permissive licence; same interface as
   fft_fftw.c.

   Stockham's autosort with radices 4, 2, 3, 5 and any other prime r: with n = r m and s interleaved
   lines,

     y[s (r p + j) + q] = w^(p j) sum_k x[s (p + m k) + q] exp(-2 pi i j k/r),  w = exp(-2 pi i/n),

   and then n := m, s := r s (Van Loan, Computational Frameworks for the Fast Fourier Transform,
   SIAM 1992, section 1.7). Axes of a box are interleaved lines in their given layout. Lengths with
   a large prime are convolutions of a length 2^k (Bluestein, IEEE Trans. Audio Electroacoust. 18
   (1970) 451). Transforms of even real signals are complex ones of half the length. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
  double re, im;
} value;

enum { most_stages = 40, longest_radix = 64 };

/* One axis. Twiddles w^p, p = 0 ... n - 1; for Bluestein: chirp exp(-i pi j^2/n) and the transform
   of its conjugate, over the longer axis. */
typedef struct axis {
  int n, n_stages, radix[most_stages];
  value *twiddle, *chirp, *response;
  struct axis *longer;
} axis;

typedef struct {
  /* Axes of a box, the last contiguous: of half its length if that is even. */
  axis *along[3];
  int n[3];
  /* exp(-2 pi i k/n) of the contiguous axis, k = 0 ... n/2. */
  value *root;
} plan_type;

static value product(value a, value b) {
  value c = {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
  return c;
}

/* exp(-2 pi i k/n), reduced to an angle of at most pi/4. */
static value unit_root(long long k, long long n) {
  const double pi = 3.14159265358979323846;
  long long eighth = 8 * (k % n) / n, quarter = (eighth + 1) / 2;
  double angle = 2.0 * pi * (double)(4 * (k % n) - quarter * n) / (4.0 * (double)n);
  double c = cos(angle), s = sin(angle);
  value w[4] = {{c, -s}, {-s, -c}, {-c, s}, {s, c}};
  return w[quarter % 4];
}

static void *room(size_t n, size_t size) { return malloc((n ? n : 1) * size); }

static void free_axis(axis *a) {
  if (a == NULL) return;
  free(a->twiddle);
  free(a->chirp);
  free(a->response);
  free_axis(a->longer);
  free(a);
}

/* One stage of radix r, from x to y. */
static void stage(int r, int m, size_t s, const value *w, int step, const value *x, value *y) {
  size_t q;
  int p, j, k;
  for (p = 0; p < m; p++) {
    const value *a = x + s * (size_t)p;
    value *b = y + s * (size_t)(r * p);
    size_t gap = s * (size_t)m;
    if (r == 4) {
      value w_1 = w[p * step], w_2 = w[2 * p * step], w_3 = w[3 * p * step];
      for (q = 0; q < s; q++) {
        value a_0 = a[q], a_1 = a[gap + q], a_2 = a[2 * gap + q], a_3 = a[3 * gap + q];
        value even = {a_0.re + a_2.re, a_0.im + a_2.im}, less = {a_0.re - a_2.re, a_0.im - a_2.im};
        value odd = {a_1.re + a_3.re, a_1.im + a_3.im}, turned = {a_1.im - a_3.im, a_3.re - a_1.re};
        value t_1 = {less.re + turned.re, less.im + turned.im};
        value t_2 = {even.re - odd.re, even.im - odd.im};
        value t_3 = {less.re - turned.re, less.im - turned.im};
        b[q].re = even.re + odd.re;
        b[q].im = even.im + odd.im;
        b[s + q] = product(w_1, t_1);
        b[2 * s + q] = product(w_2, t_2);
        b[3 * s + q] = product(w_3, t_3);
      }
    } else if (r == 2) {
      value w_1 = w[p * step];
      for (q = 0; q < s; q++) {
        value a_0 = a[q], a_1 = a[gap + q], less = {a_0.re - a_1.re, a_0.im - a_1.im};
        b[q].re = a_0.re + a_1.re;
        b[q].im = a_0.im + a_1.im;
        b[s + q] = product(w_1, less);
      }
    } else {
      /* exp(-2 pi i j k/r) = w^(j k m) over the present length r m. */
      int whole = m * step;
      for (j = 0; j < r; j++) {
        value *to = b + s * (size_t)j;
        value outer = w[(size_t)p * (size_t)j * (size_t)step % ((size_t)whole * (size_t)r)];
        memcpy(to, a, s * sizeof *to);
        for (k = 1; k < r; k++) {
          value inner = w[(size_t)(j * k % r) * (size_t)whole];
          const value *from = a + gap * (size_t)k;
          for (q = 0; q < s; q++) {
            to[q].re += inner.re * from[q].re - inner.im * from[q].im;
            to[q].im += inner.re * from[q].im + inner.im * from[q].re;
          }
        }
        for (q = 0; q < s; q++) to[q] = product(outer, to[q]);
      }
    }
  }
}

static void transform(const axis *a, size_t s, value *x, value *work);

/* sum_j x_j w^(j k) = chirp_k sum_j (x_j chirp_j) conj(chirp_(k - j)). */
static void bluestein(const axis *a, value *x) {
  int i, n = a->n, m = a->longer->n;
  value *padded = room((size_t)m, sizeof *padded), *work = room((size_t)m, sizeof *work);
  for (i = 0; i < n; i++) padded[i] = product(x[i], a->chirp[i]);
  memset(padded + n, 0, (size_t)(m - n) * sizeof *padded);
  transform(a->longer, 1, padded, work);
  for (i = 0; i < m; i++) {
    value c = product(padded[i], a->response[i]);
    /* Exchange real and imaginary parts for the inverse transform. */
    padded[i].re = c.im;
    padded[i].im = c.re;
  }
  transform(a->longer, 1, padded, work);
  for (i = 0; i < n; i++) {
    value c = {padded[i].im / m, padded[i].re / m};
    x[i] = product(c, a->chirp[i]);
  }
  free(padded);
  free(work);
}

/* s interleaved lines of length n, in place; work has the same size. */
static void transform(const axis *a, size_t s, value *x, value *work) {
  value *from = x, *to = work, *other;
  int i, n = a->n;
  size_t total = s * (size_t)n;
  if (a->longer != NULL) {
    bluestein(a, x);
    return;
  }
  for (i = 0; i < a->n_stages; i++) {
    int r = a->radix[i], m = n / r;
    stage(r, m, s, a->twiddle, a->n / n, from, to);
    n = m;
    s *= (size_t)r;
    other = from;
    from = to;
    to = other;
  }
  if (from != x) memcpy(x, from, total * sizeof *x);
}

/* alone: lines are transformed one by one, and may have any length. */
static axis *new_axis(int n, int alone) {
  static const int first[] = {4, 2, 3, 5, 7};
  axis *a = calloc(1, sizeof *a), *longer;
  int i, rest = n, r = 7, m = 1;
  value *work;
  a->n = n;
  for (i = 0; i < 5; i++)
    while (rest % first[i] == 0) {
      a->radix[a->n_stages++] = first[i];
      rest /= first[i];
    }
  while (rest > 1 && (r < longest_radix || !alone)) {
    r += 2;
    while (rest % r == 0) {
      a->radix[a->n_stages++] = r;
      rest /= r;
    }
  }
  a->twiddle = room((size_t)n, sizeof *a->twiddle);
  for (i = 0; i < n; i++) a->twiddle[i] = unit_root(i, n);
  if (rest == 1) return a;
  while (m < 2 * n - 1) m *= 2;
  a->longer = longer = new_axis(m, 1);
  a->chirp = room((size_t)n, sizeof *a->chirp);
  a->response = room((size_t)m, sizeof *a->response);
  memset(a->response, 0, (size_t)m * sizeof *a->response);
  for (i = 0; i < n; i++) {
    a->chirp[i] = unit_root((long long)i * i % (2LL * n), 2LL * n);
    a->response[i].re = a->chirp[i].re;
    a->response[i].im = -a->chirp[i].im;
    if (i > 0) a->response[m - i] = a->response[i];
  }
  work = room((size_t)m, sizeof *work);
  transform(longer, 1, a->response, work);
  free(work);
  return a;
}

/* A box of n_1 x n_2 x n_3, the last contiguous. */
static plan_type *new_plan(int n_1, int n_2, int n_3) {
  plan_type *plan = calloc(1, sizeof *plan);
  int k, alone = n_1 * n_2 == 1;
  plan->n[0] = n_1;
  plan->n[1] = n_2;
  plan->n[2] = n_3;
  if (n_1 > 1) plan->along[0] = new_axis(n_1, 0);
  if (n_2 > 1) plan->along[1] = new_axis(n_2, 0);
  plan->along[2] = new_axis(n_3 % 2 == 0 ? n_3 / 2 : n_3, alone);
  plan->root = room((size_t)(n_3 / 2 + 1), sizeof *plan->root);
  for (k = 0; k <= n_3 / 2; k++) plan->root[k] = unit_root(k, n_3);
  return plan;
}

plan_type *viscovib_plan_line(int n, double *signal, value *spectrum) {
  (void)signal;
  (void)spectrum;
  return new_plan(1, 1, n);
}

plan_type *viscovib_plan_box(int n_1, int n_2, int n_3, double *u, value *c) {
  (void)u;
  (void)c;
  return new_plan(n_1, n_2, n_3);
}

plan_type *viscovib_plan_box_back(int n_1, int n_2, int n_3, value *c, double *u) {
  (void)u;
  (void)c;
  return new_plan(n_1, n_2, n_3);
}

/* c_k = sum_j u_j exp(-2 pi i j k/n), k = 0 ... n/2, of one line; work has 2 n. */
static void line(const plan_type *plan, const double *u, value *c, value *work) {
  int k, n = plan->n[2], h = n / 2;
  value *z = work;
  if (n % 2 == 1) {
    for (k = 0; k < n; k++) {
      z[k].re = u[k];
      z[k].im = 0.0;
    }
    transform(plan->along[2], 1, z, work + n);
    memcpy(c, z, (size_t)(h + 1) * sizeof *c);
    return;
  }
  memcpy(z, u, (size_t)n * sizeof *u);
  transform(plan->along[2], 1, z, work + n);
  for (k = 0; k <= h; k++) {
    value a = z[k % h], b = z[(h - k) % h], even, odd, turned;
    even.re = 0.5 * (a.re + b.re);
    even.im = 0.5 * (a.im - b.im);
    odd.re = 0.5 * (a.im + b.im);
    odd.im = 0.5 * (b.re - a.re);
    turned = product(plan->root[k], odd);
    c[k].re = even.re + turned.re;
    c[k].im = even.im + turned.im;
  }
}

/* u_j = sum of c_k exp(2 pi i j k/n) over all k, c_(n - k) = conj(c_k); work has 2 n. The inverse
   transform is a transform of conjugates. */
static void line_back(const plan_type *plan, const value *c, double *u, value *work) {
  int k, n = plan->n[2], h = n / 2;
  value *z = work;
  if (n % 2 == 1) {
    z[0].re = c[0].re;
    z[0].im = 0.0;
    for (k = 1; k <= h; k++) {
      z[k].re = z[n - k].re = c[k].re;
      z[k].im = -c[k].im;
      z[n - k].im = c[k].im;
    }
    transform(plan->along[2], 1, z, work + n);
    for (k = 0; k < n; k++) u[k] = z[k].re;
    return;
  }
  for (k = 0; k < h; k++) {
    value a = c[k], b = c[h - k], even, less, odd, back = plan->root[k];
    if (k == 0) a.im = b.im = 0.0;
    even.re = a.re + b.re;
    even.im = a.im - b.im;
    less.re = a.re - b.re;
    less.im = a.im + b.im;
    back.im = -back.im;
    odd = product(back, less);
    /* The conjugate of even + i odd. */
    z[k].re = even.re - odd.im;
    z[k].im = -(even.im + odd.re);
  }
  transform(plan->along[2], 1, z, work + n);
  for (k = 0; k < h; k++) {
    u[2 * k] = z[k].re;
    u[2 * k + 1] = -z[k].im;
  }
}

/* Transform along the axes that are not contiguous. */
static void across(const plan_type *plan, value *c, value *work) {
  size_t inner = (size_t)(plan->n[2] / 2 + 1), slab = inner * (size_t)plan->n[1];
  int i;
  if (plan->along[1] != NULL)
    for (i = 0; i < plan->n[0]; i++) transform(plan->along[1], inner, c + slab * (size_t)i, work);
  if (plan->along[0] != NULL) transform(plan->along[0], slab, c, work);
}

static size_t coefficients(const plan_type *plan) {
  return (size_t)(plan->n[2] / 2 + 1) * (size_t)plan->n[1] * (size_t)plan->n[0];
}

static value *new_work(const plan_type *plan) {
  return room(coefficients(plan) + 2 * (size_t)plan->n[2], sizeof(value));
}

void viscovib_transform(plan_type *plan, double *u, value *c) {
  value *work = new_work(plan);
  int i, n = plan->n[2], lines = plan->n[0] * plan->n[1];
  for (i = 0; i < lines; i++)
    line(plan, u + (size_t)n * (size_t)i, c + (size_t)(n / 2 + 1) * (size_t)i, work);
  across(plan, c, work);
  free(work);
}

void viscovib_transform_back(plan_type *plan, value *c, double *u) {
  value *work = new_work(plan);
  size_t i, total = coefficients(plan);
  int n = plan->n[2], lines = plan->n[0] * plan->n[1];
  if (lines > 1) {
    for (i = 0; i < total; i++) c[i].im = -c[i].im;
    across(plan, c, work);
    for (i = 0; i < total; i++) c[i].im = -c[i].im;
  }
  for (i = 0; i < (size_t)lines; i++)
    line_back(plan, c + (size_t)(n / 2 + 1) * i, u + (size_t)n * i, work);
  free(work);
}

void viscovib_free_plan(plan_type *plan) {
  int i;
  for (i = 0; i < 3; i++) free_axis(plan->along[i]);
  free(plan->root);
  free(plan);
}
