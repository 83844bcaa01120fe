!> Elementary functions and laws over vector lanes.
module test_vector_math
  use, intrinsic :: iso_c_binding, only: c_double
  use testing, only: begin, check, check_close
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_lanes, only: evaluate_lanes
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_vector_math, only: exponential_lanes, largest_angle, logarithm_lanes, &
    sine_cosine_array, tangent_lanes
  implicit none
  private

  public :: run_vector_math

  interface
    !> Defined in wide.c.
    real(c_double) function exact_sine(x) bind(c)
      import :: c_double
      real(c_double), value :: x
    end function exact_sine

    !> cos(p (start + h (n + c))).
    real(c_double) function exact_cosine(p, start, h, n, c) bind(c)
      import :: c_double
      real(c_double), value :: p, start, h, n, c
    end function exact_cosine
  end interface

contains

  subroutine run_vector_math()
    if (begin('sine and cosine to an ulp')) call compare_sines()
    if (begin('exp, tanh and log to two ulps')) call compare_exponentials()
    if (begin('laws over lanes are the laws')) call compare_laws()
  end subroutine run_vector_math

  subroutine compare_sines()
    real(wp) :: x(4000), s(4000), c(4000)
    integer :: i
    x = [(sin(1.7_wp*i)*merge(largest_angle, 4.0_wp, mod(i, 2) == 0), i=1, size(x))]
    call sine_cosine_array(x, s, c)
    do i = 1, size(x)
      call check_close(s(i), exact_sine(x(i)), 2.3e-16_wp, 'sine', floor=0.1_wp)
      call check_close(c(i), exact_cosine(1.0_wp, x(i), 0.0_wp, 0.0_wp, 0.0_wp), 2.3e-16_wp, &
                       'cosine', floor=0.1_wp)
    end do
  end subroutine compare_sines

  subroutine compare_exponentials()
    real(wp) :: x(n_lanes), y(n_lanes)
    integer :: i, l
    do i = 1, 500
      x = [(sin(1.7_wp*(n_lanes*i + l))*10.0_wp**mod(n_lanes*i + l, 3), l=1, n_lanes)]
      call exponential_lanes(7.0_wp*x, y)
      do l = 1, n_lanes
        call check_close(y(l), exp(7.0_wp*x(l)), 4.5e-16_wp, 'exp')
      end do
      x = x*10.0_wp**(1 - mod(i, 8))
      call tangent_lanes(x, y)
      do l = 1, n_lanes
        call check_close(y(l), tanh(x(l)), 7.0e-16_wp, 'tanh')
      end do
      x = exp(0.2_wp*x)
      call logarithm_lanes(x, y)
      do l = 1, n_lanes
        call check_close(y(l), log(x(l)), 4.5e-16_wp, 'log', floor=1.0e-3_wp)
      end do
    end do
  end subroutine compare_exponentials

  !> Arguments inside and outside the domain of each function.
  subroutine compare_laws()
    character(len=*), parameter :: texts(19) = [character(len=48) :: &
      'sin(x)*cos(y) - x/y', 'exp(x) + tanh(3*y)', 'log(x)', 'sqrt(y) + x^2', 'x^(-1.5)', 'y^3', &
      'x^0.7', 'abs(x - y) + sign(x*y)', 'min(x, y) - max(x, 0.3)', 'where(x > y, x, y^5)', &
      '(x < y) + (x <= 0) + (y >= x)', 'heaviside(x)*y', 'asin(x) + atan(y)', 'sinh(x) - cosh(y)', &
      'atan2(x, y)', 'pow(abs(x), y)', 'x/(x^2 + 0.1)^1.5', 'exp(200*x)', 'acosh(y) + atanh(x)']
    type(law_program) :: law
    character(len=:), allocatable :: fault
    real(wp) :: at(n_lanes, 2), one(n_lanes), other(n_lanes), alone(n_lanes)
    integer :: degree, i, k, l, parity

    do i = 1, size(texts)
      call compile_law(trim(texts(i)), ['x', 'y'], [character(len=1) ::], [real(wp) ::], law, &
                       parity, degree, fault)
      call check(fault == '', 'compiles '//trim(texts(i))//': '//fault)
      do k = 1, 40
        at(:, 1) = [(2.0_wp*sin(2.3_wp*(n_lanes*k + l)), l=1, n_lanes)]
        at(:, 2) = [(3.0_wp*cos(1.9_wp*(n_lanes*k + l)), l=1, n_lanes)]
        if (mod(k, 5) == 0) at(3:5, 1) = 0.0_wp
        if (mod(k, 7) == 0) at(4:6, 2) = 0.0_wp
        if (mod(k, 6) == 0) at(2, :) = 1.0e7_wp
        call law%evaluate(at, one)
        call evaluate_lanes(law, at, other)
        do l = 1, n_lanes
          call evaluate_lanes(law, spread(at(l, :), 1, n_lanes), alone)
          call check(abs(alone(l) - other(l)) <= 0.0_wp, 'alone as in lanes: '//trim(texts(i)))
          call check_close(other(l), one(l), 2.0e-15_wp, trim(texts(i)), floor=1.0_wp)
        end do
      end do
    end do
  end subroutine compare_laws

end module test_vector_math
