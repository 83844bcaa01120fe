!> Time integration: coefficients, phases, and a run of the pendulum.
module test_transient
  use, intrinsic :: iso_c_binding, only: c_double
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_gauss, only: gauss_type, new_gauss
  use viscovib_gauss_table, only: gauss_table_type, new_gauss_table
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: equations_exact, equations_printed, new_pendulum, &
    pendulum_parameters, pendulum_type
  use viscovib_phases, only: new_phases, phases_type
  use viscovib_simulate, only: run_coarse, run_completed, run_unphysical, simulate
  use viscovib_status, only: status_type
  use viscovib_vector_math, only: largest_angle, sine_cosine
  implicit none
  private

  public :: run_transient

  interface
    !> In wide.c.
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
    if (begin('collocation integrates polynomials')) call integrate_powers()
    if (begin('phases after a million steps')) call long_phases()
    if (begin('every equation runs and keeps to its start at rest')) call rest()
    if (begin('outcomes')) call outcomes()
  end subroutine run_transient

  subroutine compare_sines()
    real(wp) :: x, s, c
    integer :: i
    do i = 1, 4000
      x = sin(1.7_wp*i)*merge(largest_angle, 4.0_wp, mod(i, 2) == 0)
      call sine_cosine(x, s, c)
      call check_close(s, exact_sine(x), 2.3e-16_wp, 'sine', floor=0.1_wp)
      call check_close(c, exact_cosine(1.0_wp, x, 0.0_wp, 0.0_wp, 0.0_wp), 2.3e-16_wp, &
                       'cosine', floor=0.1_wp)
    end do
  end subroutine compare_sines

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
    real(wp) :: states(6, 10), no_times(0), no_states(6, 0)
    integer(i8) :: n_done
    real(wp) :: t_reached
    integer :: equations, outcome, n_reached
    do equations = equations_exact, equations_printed
      call example(equations, pendulum)
      call new_gauss(method, pendulum, 8, [0.0_wp, 0.0_wp, 0.0_wp], [0.0_wp, 0.0_wp, 0.0_wp], &
                     0.0_wp, 0.5_wp, 1.0e-15_wp)
      call simulate(method, pendulum, 0_i8, 20_i8, 2_i8, no_times, states, no_states, n_done, &
                    n_reached, t_reached, outcome)
      call check(outcome == run_completed .and. n_done == 20_i8, 'completed')
      call check_close(maxval(abs(states)), 0.0_wp, 0.0_wp, 'rest')
    end do
  end subroutine rest

  subroutine outcomes()
    type(pendulum_type) :: pendulum
    type(gauss_type) :: method
    real(wp) :: states(6, 0), no_times(0), no_states(6, 0)
    integer(i8) :: n_done
    real(wp) :: t_reached
    integer :: outcome, n_reached

    call example(equations_exact, pendulum)
    call new_gauss(method, pendulum, 8, [0.0_wp, 0.0_wp, 0.0_wp], [-3.0_wp, 0.0_wp, 0.0_wp], &
                   0.0_wp, 0.1_wp, 1.0e-15_wp)
    call simulate(method, pendulum, 0_i8, 1000_i8, 1_i8, no_times, states, no_states, n_done, &
                  n_reached, t_reached, outcome)
    call check(outcome == run_unphysical, 'through the pivot')
    call new_gauss(method, pendulum, 8, [0.05_wp, 0.3_wp, -0.2_wp], [0.0_wp, 0.0_wp, 0.0_wp], &
                   0.0_wp, 20.0_wp, 1.0e-15_wp)
    call simulate(method, pendulum, 0_i8, 10_i8, 1_i8, no_times, states, no_states, n_done, &
                  n_reached, t_reached, outcome)
    call check(outcome == run_coarse, 'too large a step')
    call check(all(abs(method%q) < huge(1.0_wp)), 'the state is still a number')
  end subroutine outcomes

end module test_transient
