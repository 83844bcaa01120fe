!> Time integration: coefficients, phases, and a run of the pendulum.
module test_transient
  use, intrinsic :: iso_c_binding, only: c_double
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_gauss, only: gauss_type, new_gauss
  use viscovib_gauss_table, only: gauss_table_type, new_gauss_table
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_lanes, only: evaluate_lanes
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_pendulum, only: equations_exact, equations_printed, new_pendulum, &
    pendulum_parameters, pendulum_type
  use viscovib_phases, only: new_phases, phases_type
  use viscovib_simulate, only: simulate
  use viscovib_status, only: status_type
  use viscovib_time_run, only: run_coarse, run_completed, run_unphysical, time_run
  use viscovib_vector_math, only: exponential_lanes, largest_angle, logarithm_lanes, &
    sine_cosine_array, tangent_lanes
  implicit none
  private

  public :: run_transient

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

  subroutine run_transient()
    if (begin('sine and cosine to an ulp')) call compare_sines()
    if (begin('exp, tanh and log to two ulps')) call compare_exponentials()
    if (begin('laws over lanes are the laws')) call compare_laws()
    if (begin('collocation integrates polynomials')) call integrate_powers()
    if (begin('phases after a million steps')) call long_phases()
    if (begin('every equation runs and keeps to its start at rest')) call rest()
    if (begin('outcomes')) call outcomes()
  end subroutine run_transient

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

  !> sum_j b_j c_j^k = 1/(k+1) up to k = 2s-1; sum_j a_ij c_j^k = c_i^(k+1)/(k+1)
  !! up to k = s-1; the same twice for the square of a.
  subroutine integrate_powers()
    type(gauss_table_type) :: table
    real(wp), allocatable :: c(:), f(:)
    real(wp) :: x
    integer :: s, k, i

    do s = 1, 16
      call new_gauss_table(table, s, s - 1)
      c = reshape(table%nodes, [size(table%nodes)])
      do k = 0, 2*s - 1
        f = [(merge(c(i)**k, 0.0_wp, i <= s), i=1, size(c))]
        call check_close(sum(reshape(table%weights, [size(c)])*f), 1.0_wp/(k + 1), 1.0e-15_wp, &
                         'b', floor=1.0_wp)
        if (k < 2*s - 1) then
          call check_close(sum(reshape(table%weights_q, [size(c)])*f), &
                           1.0_wp/((k + 1)*(k + 2)), 1.0e-15_wp, 'b of q', floor=1.0_wp)
        end if
        if (k >= s) cycle
        do i = 1, s
          associate (l => mod(i - 1, n_lanes) + 1, b => (i - 1)/n_lanes + 1)
            x = sum(reshape(table%a(l, :, :, b), [size(f)])*f)
            call check_close(x, c(i)**(k + 1)/(k + 1), 1.0e-15_wp, 'a', floor=1.0_wp)
            x = sum(reshape(table%a_q(l, :, :, b), [size(f)])*f)
            if (k == s - 1) cycle
            call check_close(x, c(i)**(k + 2)/((k + 1)*(k + 2)), 1.0e-15_wp, 'a of q', floor=1.0_wp)
          end associate
        end do
      end do
    end do
  end subroutine integrate_powers

  subroutine long_phases()
    type(phases_type) :: phases
    real(wp) :: cosines(n_lanes, 2), p(2), h
    integer :: i, j
    integer, parameter :: n = 1000000

    p = [0.93_wp, 17.3_wp]
    h = 0.37_wp
    call new_phases(phases, p, 2.5_wp, h, reshape([(0.1_wp*i, i=1, n_lanes)], [n_lanes, 1]))
    do i = 1, n
      call phases%advance()
    end do
    call phases%drives(1, cosines)
    do j = 1, 2
      call check_close(cosines(3, j), exact_cosine(p(j), 2.5_wp, h, real(n, wp), 0.3_wp), &
                       1.0e-15_wp, 'drive', floor=1.0_wp)
    end do
  end subroutine long_phases

  subroutine example(equations, pendulum)
    integer, intent(in) :: equations
    type(pendulum_type), intent(out) :: pendulum
    type(pendulum_parameters) :: p
    type(status_type) :: status
    p = pendulum_parameters(e=0.1_wp, w2=0.4_wp, w3=0.8_wp, alpha=0.5_wp, equations=equations)
    call new_pendulum(pendulum, p, status)
    call check_ok(status)
    p%e = 0.3_wp
    call check_bad(p)
  end subroutine example

  subroutine check_bad(p)
    type(pendulum_parameters), intent(in) :: p
    type(pendulum_type) :: pendulum
    type(status_type) :: status
    call new_pendulum(pendulum, p, status)
    call check_fails(status, 'must be less than 1')
  end subroutine check_bad

  subroutine rest()
    type(pendulum_type) :: pendulum
    type(gauss_type) :: method
    type(time_run) :: run
    integer :: equations

    run%n_steps = 20
    run%save_every = 2
    call run%allocate_states(6, 10, 0.5_wp)
    do equations = equations_exact, equations_printed
      call example(equations, pendulum)
      call new_gauss(method, pendulum, 8, [0.0_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.0_wp], &
                     0.0_wp, 0.5_wp, 1.0e-15_wp)
      call simulate(method, pendulum, run)
      call check(run%ended == run_completed .and. run%n_done == 20_i8, 'completed')
      call check_close(maxval(abs(run%states)), 0.0_wp, 0.0_wp, 'rest')
    end do
  end subroutine rest

  subroutine outcomes()
    type(pendulum_type) :: pendulum
    type(gauss_type) :: method
    type(time_run) :: pivot, large

    call example(equations_exact, pendulum)
    call new_gauss(method, pendulum, 8, [0.0_wp, 0.0_wp, 0.0_wp], [-3.0_wp, 0.0_wp, 0.0_wp], &
                   0.0_wp, 0.1_wp, 1.0e-15_wp)
    pivot%n_steps = 1000
    call pivot%allocate_states(6, 0, 0.1_wp)
    call simulate(method, pendulum, pivot)
    call check(pivot%ended == run_unphysical, 'through the pivot')
    call new_gauss(method, pendulum, 8, [0.05_wp, 0.3_wp, -0.2_wp], [0.0_wp, 0.0_wp, 0.0_wp], &
                   0.0_wp, 20.0_wp, 1.0e-15_wp)
    large%n_steps = 10
    call large%allocate_states(6, 0, 20.0_wp)
    call simulate(method, pendulum, large)
    call check(large%ended == run_coarse, 'too large a step')
    call check(all(abs(method%q) < huge(1.0_wp)), 'the state is still a number')
  end subroutine outcomes

end module test_transient
