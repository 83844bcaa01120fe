!> The plain arithmetic of the hot paths with shapes known to the compiler.
!!
!! Eight numbers form a register. Loops that keep sums in registers are not vectorized
!! (`novector`), as in viscovib_node_kernels.
module floor_kernels
  use, intrinsic :: iso_fortran_env, only: i8 => int64, wp => real64
  implicit none
  private

  public :: divisions, complex_lu_20, history_update, lu_20, multiply_adds, plain_power, &
    real_lu_6, response_iteration, sines, step_products, triad

  integer, parameter, public :: lanes = 8
  real(wp), parameter :: rounder = 6755399441055744.0_wp

contains

  !> n times twelve independent multiply-adds of a register.
  subroutine multiply_adds(n, factor, sums)
    integer, intent(in) :: n
    real(wp), intent(in) :: factor(lanes)
    real(wp), intent(inout) :: sums(lanes, 12)
    real(wp), dimension(lanes) :: a, b, c, d, e, f, g, h, o, p, q, r
    integer :: i

    a = sums(:, 1); b = sums(:, 2); c = sums(:, 3); d = sums(:, 4); e = sums(:, 5)
    f = sums(:, 6); g = sums(:, 7); h = sums(:, 8); o = sums(:, 9); p = sums(:, 10)
    q = sums(:, 11); r = sums(:, 12)
    !GCC$ novector
    do i = 1, n
      a = a*factor + factor
      b = b*factor + factor
      c = c*factor + factor
      d = d*factor + factor
      e = e*factor + factor
      f = f*factor + factor
      g = g*factor + factor
      h = h*factor + factor
      o = o*factor + factor
      p = p*factor + factor
      q = q*factor + factor
      r = r*factor + factor
    end do
    sums = reshape([a, b, c, d, e, f, g, h, o, p, q, r], [lanes, 12])
  end subroutine multiply_adds

  !> One quotient each.
  pure subroutine divisions(n, x, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n)
    real(wp), intent(out) :: y(n)
    integer :: i
    do i = 1, n
      y(i) = 1.0_wp/x(i)
    end do
  end subroutine divisions

  !> Sine and cosine: one reduction, two polynomials; the quadrant is not applied.
  pure subroutine sines(n, x, s, c)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(n)
    real(wp), intent(out) :: s(n), c(n)
    real(wp) :: t, z
    integer :: i

    do i = 1, n
      t = x(i) - ((x(i)*0.636619772367581343_wp + rounder) - rounder)*1.5707963267948966_wp
      z = t*t
      s(i) = t + t*z*(-1.66666666666666324e-1_wp + z*(8.33333333332248946e-3_wp &
             + z*(-1.98412698298579493e-4_wp + z*(2.75573137070700677e-6_wp &
             + z*(-2.50507602534068634e-8_wp + z*1.58969099521155010e-10_wp)))))
      c(i) = (1.0_wp - 0.5_wp*z) + z*z*(4.16666666666666019e-2_wp &
             + z*(-1.38888888888741096e-3_wp + z*(2.48015872894767294e-5_wp &
             + z*(-2.75573143513906633e-7_wp + z*(2.08757232129817483e-9_wp &
             - z*1.13596475577881948e-11_wp)))))
    end do
  end subroutine sines

  !> (x + i y)^(-a): a logarithm, an exponential, an arc tangent, a sine and a cosine, each a
  !! plain polynomial in double precision, two quotients in all.
  pure subroutine plain_power(n, x, a, y, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: x, a, y(n)
    real(wp), intent(out) :: re(n), im(n)
    integer(i8), parameter :: one = transfer(1.0_wp, 0_i8), magic = transfer(rounder, 0_i8)
    integer(i8) :: bits, power_of_2
    real(wp) :: q, k, m, s, z, log_q, r, e, t, angle, sine, cosine, turns
    integer :: i

    do i = 1, n
      q = x*x + y(i)*y(i)
      bits = transfer(q, 0_i8)
      power_of_2 = shiftr(bits, 52)
      k = transfer(power_of_2 + magic, 0.0_wp) - (rounder + 1023.0_wp)
      m = transfer(bits - shiftl(power_of_2 - 1023_i8, 52), 0.0_wp)
      s = (m - 1.4_wp)/(m + 1.4_wp)
      z = s*s
      log_q = k*0.6931471805599453_wp + 0.3364722366212129_wp + s*(2.0_wp &
              + z*(0.6666666666666667_wp &
              + z*(0.4_wp + z*(0.2857142857142857_wp + z*(0.2222222222222222_wp &
              + z*(0.1818181818181818_wp + z*(0.1538461538461538_wp + z*0.1333333333333333_wp)))))))
      r = -0.5_wp*a*log_q
      turns = r*1.4426950408889634_wp + rounder
      bits = transfer(turns, 0_i8)
      r = r - (turns - rounder)*0.6931471805599453_wp
      e = 1.0_wp + r*(1.0_wp + r*(0.5_wp + r*(0.1666666666666667_wp + r*(4.166666666666667e-2_wp &
          + r*(8.333333333333333e-3_wp + r*(1.388888888888889e-3_wp + r*(1.984126984126984e-4_wp &
          + r*(2.480158730158730e-5_wp + r*(2.755731922398589e-6_wp &
          + r*2.755731922398589e-7_wp)))))))))
      e = e*transfer(shiftl(bits, 52) + one, 0.0_wp)
      t = min(x, y(i))/max(x, y(i))
      z = t*t
      angle = t*(1.0_wp + z*(-0.3333333333333_wp + z*(0.2_wp + z*(-0.1428571428571_wp &
              + z*(0.1111111111111_wp + z*(-0.0909090909091_wp + z*(0.0769230769231_wp &
              + z*(-0.0666666666667_wp + z*(0.0588235294118_wp - z*0.0526315789474_wp)))))))))
      t = a*angle
      z = t*t
      sine = t + t*z*(-1.66666666666666324e-1_wp + z*(8.33333333332248946e-3_wp &
             + z*(-1.98412698298579493e-4_wp + z*(2.75573137070700677e-6_wp &
             + z*(-2.50507602534068634e-8_wp + z*1.58969099521155010e-10_wp)))))
      cosine = (1.0_wp - 0.5_wp*z) + z*z*(4.16666666666666019e-2_wp &
               + z*(-1.38888888888741096e-3_wp + z*(2.48015872894767294e-5_wp &
               + z*(-2.75573143513906633e-7_wp + z*(2.08757232129817483e-9_wp &
               - z*1.13596475577881948e-11_wp)))))
      re(i) = e*cosine
      im(i) = e*sine
    end do
  end subroutine plain_power

  !> a b + c, from memory to memory.
  pure subroutine triad(n, a, b, c, factor)
    integer, intent(in) :: n
    real(wp), intent(out) :: a(n)
    real(wp), intent(in) :: b(n), c(n), factor
    integer :: i
    do i = 1, n
      a(i) = b(i) + factor*c(i)
    end do
  end subroutine triad

  !> LU factors of 20 equations, columns padded to whole registers, with pivoting; one solution.
  pure subroutine lu_20(matrix, x)
    integer, parameter :: n = 20, rows = 24
    real(wp), intent(inout) :: matrix(rows, n), x(rows)
    real(wp) :: factor, swapped
    integer :: i, j, k, pivot

    do k = 1, n
      pivot = k - 1 + maxloc(abs(matrix(k:n, k)), 1)
      if (pivot /= k) then
        do j = 1, n
          swapped = matrix(k, j)
          matrix(k, j) = matrix(pivot, j)
          matrix(pivot, j) = swapped
        end do
        swapped = x(k)
        x(k) = x(pivot)
        x(pivot) = swapped
      end if
      factor = 1.0_wp/matrix(k, k)
      matrix(k + 1:n, k) = factor*matrix(k + 1:n, k)
      do j = k + 1, n
        do i = k + 1, n
          matrix(i, j) = matrix(i, j) - matrix(i, k)*matrix(k, j)
        end do
      end do
      do i = k + 1, n
        x(i) = x(i) - matrix(i, k)*x(k)
      end do
    end do
    do k = n, 1, -1
      x(k) = x(k)/matrix(k, k)
      do i = 1, k - 1
        x(i) = x(i) - matrix(i, k)*x(k)
      end do
    end do
  end subroutine lu_20

  !> LU factors of 20 complex equations, separate real and imaginary parts, diagonal pivots.
  pure subroutine complex_lu_20(re, im)
    integer, parameter :: n = 20, rows = 24
    real(wp), intent(inout) :: re(rows, n), im(rows, n)
    real(wp) :: size_of, a, b, c, d
    integer :: i, j, k

    do k = 1, n
      size_of = 1.0_wp/(re(k, k)**2 + im(k, k)**2)
      a = re(k, k)*size_of
      b = -im(k, k)*size_of
      do i = k + 1, n
        c = re(i, k)*a - im(i, k)*b
        im(i, k) = re(i, k)*b + im(i, k)*a
        re(i, k) = c
      end do
      do j = k + 1, n
        c = re(k, j)
        d = im(k, j)
        do i = k + 1, n
          re(i, j) = re(i, j) - (re(i, k)*c - im(i, k)*d)
          im(i, j) = im(i, j) - (re(i, k)*d + im(i, k)*c)
        end do
      end do
    end do
  end subroutine complex_lu_20

  !> LU factors of six equations, eight problems in parallel. Eigenvalues of order six cost about
  !! ten times that.
  pure subroutine real_lu_6(matrix)
    real(wp), intent(inout) :: matrix(lanes, 6, 6)
    integer :: i, j, k
    do k = 1, 6
      do i = k + 1, 6
        matrix(:, i, k) = matrix(:, i, k)/matrix(:, k, k)
        do j = k + 1, 6
          matrix(:, i, j) = matrix(:, i, j) - matrix(:, i, k)*matrix(:, k, j)
        end do
      end do
    end do
  end subroutine real_lu_6

  !> Memory of two channels with 32 exponentials over a step of four nodes: memory at the nodes, and
  !! the states at the end.
  pure subroutine history_update(recall, decay, gain, g, state, remembered)
    integer, parameter :: terms = 32, points = 6
    real(wp), intent(in) :: recall(lanes, terms), decay(terms), gain(terms, points), g(points, 2)
    real(wp), intent(inout) :: state(terms, 2)
    real(wp), intent(out) :: remembered(lanes, 2)
    real(wp), dimension(lanes) :: a, b, c, d, one, two
    integer :: q, k

    a = 0.0_wp
    b = 0.0_wp
    c = 0.0_wp
    d = 0.0_wp
    !GCC$ novector
    do q = 1, terms, 2
      a = a + recall(:, q)*state(q, 1)
      b = b + recall(:, q)*state(q, 2)
      c = c + recall(:, q + 1)*state(q + 1, 1)
      d = d + recall(:, q + 1)*state(q + 1, 2)
    end do
    remembered(:, 1) = a + c
    remembered(:, 2) = b + d
    do q = 1, terms, lanes
      one = decay(q:q + lanes - 1)*state(q:q + lanes - 1, 1)
      two = decay(q:q + lanes - 1)*state(q:q + lanes - 1, 2)
      !GCC$ novector
      do k = 1, points
        one = one + gain(q:q + lanes - 1, k)*g(k, 1)
        two = two + gain(q:q + lanes - 1, k)*g(k, 2)
      end do
      state(q:q + lanes - 1, 1) = one
      state(q:q + lanes - 1, 2) = two
    end do
  end subroutine history_update

  !> Products of three iterations of a step with memory (four nodes, two nonlinear coordinates):
  !! 16 x 22 once, 16 x 10 four times, each dependent on the previous one.
  pure subroutine step_products(linear, bend, z, y, x)
    integer, parameter :: rows = 16, inputs = 22, bends = 10
    real(wp), intent(in) :: linear(rows, inputs), bend(rows, bends), z(inputs)
    real(wp), intent(inout) :: y(bends)
    real(wp), intent(out) :: x(rows)
    real(wp), dimension(lanes) :: a, b, c, d
    integer :: k, turn

    a = 0.0_wp
    b = 0.0_wp
    !GCC$ novector
    do k = 1, inputs
      a = a + linear(:lanes, k)*z(k)
      b = b + linear(lanes + 1:, k)*z(k)
    end do
    do turn = 1, 4
      c = a
      d = b
      !GCC$ novector
      do k = 1, bends
        c = c + bend(:lanes, k)*y(k)
        d = d + bend(lanes + 1:, k)*y(k)
      end do
      x(:lanes) = c
      x(lanes + 1:) = d
      y(:5) = x(:5)*x(6:10)*x(6:10)
      y(6:) = x(6:10)*x(6:10)*x(6:10)
    end do
  end subroutine step_products

  !> One iteration for eight frequencies: five harmonics of two coordinates to 19 samples of half a
  !! period, the cubic forces, their harmonics, and the compliance.
  pure subroutine response_iteration(table, compliance, u, samples)
    integer, parameter :: n = 10, m = 19
    real(wp), intent(in) :: table(n, m), compliance(lanes, 2, 2, n)
    real(wp), intent(inout) :: u(lanes, n, 2), samples(lanes, m, 2)
    real(wp), dimension(lanes) :: a, b, x, phi
    integer :: i, k

    do i = 1, m
      a = 0.0_wp
      b = 0.0_wp
      !GCC$ novector
      do k = 1, n
        a = a + table(k, i)*u(:, k, 1)
        b = b + table(k, i)*u(:, k, 2)
      end do
      x = a
      phi = b
      samples(:, i, 1) = phi*phi*phi
      samples(:, i, 2) = phi*phi*(x - phi)
    end do
    do k = 1, n
      a = 0.0_wp
      b = 0.0_wp
      !GCC$ novector
      do i = 1, m
        a = a + table(k, i)*samples(:, i, 1)
        b = b + table(k, i)*samples(:, i, 2)
      end do
      u(:, k, 1) = compliance(:, 1, 1, k)*a + compliance(:, 1, 2, k)*b
      u(:, k, 2) = compliance(:, 2, 1, k)*a + compliance(:, 2, 2, k)*b
    end do
  end subroutine response_iteration

end module floor_kernels
