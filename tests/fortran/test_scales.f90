!> Multiple scales against known formulas, with all run-time checks.
module test_scales
  use testing, only: begin, check, check_close, check_ok
  use viscovib_counters, only: counting
  use viscovib_homotopy, only: family_type, new_family
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_modulation, only: modulate, modulation_complete
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_packed_form, only: pack_form, unpack_form
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_pendulum_form, only: new_pendulum_form, ordering_general
  use viscovib_polynomial_form, only: polynomial_form_type, term_type
  use viscovib_resonant_terms, only: list_resonances
  use viscovib_scales_response, only: response_along, steady_points_type, vary_frequency
  use viscovib_slow_flow, only: flow_term_type, slow_flow_type
  use viscovib_status, only: status_type
  use viscovib_steady_states, only: max_steady, natural_unit, steady_solver_type
  implicit none
  private

  public :: run_scales

contains

  subroutine run_scales()
    call duffing()
    call forced_duffing()
    call pendulum()
    call count_of_resonances()
    call all_steady_motions()
    call unit_of_amplitudes()
    call parametric_motions()
  end subroutine run_scales

  !> q'' + c q' + w^2 q + al q^3 = f cos(p t).
  subroutine duffing_form(form, omega, alpha, damping, load, drive)
    type(polynomial_form_type), intent(out) :: form
    real(wp), intent(in) :: omega, alpha, damping, load, drive
    form%n = 1
    form%n_dof = 1
    form%n_arguments = 1
    form%source = [1]
    form%derivative = [0]
    form%kernel_of = [0]
    allocate (form%kernels(0), form%quadratic(0))
    allocate (form%linear(1, 1, 0:2), form%hereditary(1, 1), source=0.0_wp)
    form%linear(1, 1, :) = [omega**2, damping, 1.0_wp]
    form%cubic = [term_type(1, [1, 1, 1], alpha)]
    form%load = reshape([load], [1, 1])
    form%drives = [drive]
    form%omega = [omega]
    form%right = reshape([1.0_wp], [1, 1])
    form%left = form%right
  end subroutine duffing_form

  subroutine duffing()
    type(polynomial_form_type) :: form
    type(multiple_scales_type) :: scales
    type(status_type) :: status
    complex(wp) :: gamma(1, 1), a(1, 3)
    real(wp), parameter :: omega = 1.3_wp, alpha = 0.7_wp, c = 0.02_wp
    real(wp) :: amplitude
    integer :: reached, steps, outcome, cancel

    if (begin('the frequency of a Duffing oscillator')) then
      call duffing_form(form, omega, alpha, 0.0_wp, 0.0_wp, 1.0_wp)
      call new_multiple_scales(scales, form, 0.05_wp, .false., status)
      call check_ok(status)
      gamma = scales%interaction()
      call check_close(aimag(gamma(1, 1)), 3.0_wp*alpha/(8.0_wp*omega), 1.0e-14_wp, 'gamma')
      call check_close(real(gamma(1, 1)), 0.0_wp, 1.0e-15_wp, 'no decay', floor=1.0_wp)
    end if
    if (begin('a damped amplitude decays by the linear law')) then
      call duffing_form(form, omega, alpha, c, 0.0_wp, 1.0_wp)
      call new_multiple_scales(scales, form, 0.05_wp, .false., status)
      call check_ok(status)
      cancel = 0
      call modulate(scales%flow, (0.01_wp, 0.0_wp)/scales%amplitude_units, &
                    [0.0_wp, 50.0_wp, 100.0_wp], 1.0e-11_wp, 100000, a, &
                    reached, steps, outcome, cancel)
      call check(outcome == modulation_complete .and. reached == 3, 'complete')
      ! b' = -c/2 b + rho b^3, a Bernoulli equation.
      a = a*scales%amplitude_units(1)
      gamma = scales%interaction()
      amplitude = 4.0_wp*abs(a(1, 1))**2
      amplitude = 1.0_wp/((1.0_wp/amplitude - 2.0_wp*real(gamma(1, 1))/c)*exp(c*100.0_wp) &
                          + 2.0_wp*real(gamma(1, 1))/c)
      call check_close(4.0_wp*abs(a(1, 3))**2, amplitude, 1.0e-8_wp, 'amplitude')
    end if
  end subroutine duffing

  subroutine forced_duffing()
    type(polynomial_form_type) :: form
    type(steady_points_type) :: points
    type(status_type) :: status
    real(wp), parameter :: alpha = 1.0_wp, c = 6.25e-5_wp, f = 6.25e-6_wp, p = 1.000625_wp
    real(wp) :: x, residual
    integer :: i, cancel
    if (.not. begin('three steady motions of a loaded Duffing oscillator')) return
    call duffing_form(form, 1.0_wp, alpha, c, f, p)
    cancel = 0
    call response_along(form, 1, vary_frequency, [p], 0.1_wp, .false., points, status, cancel)
    call check_ok(status)
    call check(points%n == 3, 'three of them')
    do i = 1, points%n
      ! Harmonic balance with one harmonic, equal up to the square of the amplitude.
      x = abs(points%harmonic(1, i))
      residual = x**2*((1.0_wp - p**2 + 0.75_wp*alpha*x**2)**2 + (c*p)**2) - f**2
      call check_close(residual, 0.0_wp, 0.01_wp, 'balance', floor=f**2)
    end do
    call check(maxval(real(points%eigenvalues(:, 1))) < 0.0_wp, 'the small one is stable')
    call check(maxval(real(points%eigenvalues(:, 2))) > 0.0_wp, 'the middle one is not')
    call check(maxval(real(points%eigenvalues(:, 3))) < 0.0_wp, 'the large one is stable')
  end subroutine forced_duffing

  subroutine pendulum()
    type(pendulum_type) :: system
    type(polynomial_form_type) :: form, again
    type(kernel_holder) :: none(0)
    type(status_type) :: status
    real(wp), allocatable :: packed(:)
    if (.not. begin('the form of a pendulum survives packing')) return
    call new_pendulum(system, pendulum_parameters(e=0.1_wp, w2=0.4_wp, w3=0.8_wp, alpha=0.5_wp, &
                                                  damping=[0.1_wp, 0.2_wp, 0.3_wp]), status)
    call check_ok(status)
    call new_pendulum_form(form, system, ordering_general, status)
    call check_ok(status)
    call pack_form(form, packed)
    call unpack_form(packed, none, again, status)
    call check_ok(status)
    call check(all(abs(form%linear - again%linear) <= 0.0_wp), 'linear')
    call check(all(form%cubic%row == again%cubic%row), 'rows')
    call check(all(abs(form%cubic%coefficient - again%cubic%coefficient) <= 0.0_wp), 'cubic')
    ! z'' + (1 + 3 al z_r^2) z, phi'' + e psi'' + w2^2 phi, r phi'' + psi'' + w3^2 psi.
    call check_close(form%linear(1, 1, 0), system%stiffness, 1.0e-15_wp, 'stiffness')
    call check_close(form%linear(2, 3, 2), 0.1_wp, 1.0e-15_wp, 'e')
    call check_close(form%linear(3, 2, 2), 4.0_wp, 1.0e-15_wp, 'r')
    call unpack_form(packed(:20), none, again, status)
    call check(status%failed(), 'too few numbers are an error')
  end subroutine pendulum

  subroutine count_of_resonances()
    integer, allocatable :: coefficients(:, :), orders(:)
    real(wp), allocatable :: divisors(:)
    if (.not. begin('conditions of one mode and one load')) return
    call list_resonances([1.0_wp], [1.9_wp], coefficients, orders, divisors)
    ! p ~ w; p ~ 2 w, 2 p ~ w; p ~ 3 w, 3 p ~ w (2 p ~ 2 w is no other).
    call check(all(shape(coefficients) == [2, 5]), 'five')
    call check(count(orders == 2) == 2, 'two of second order')
    call check_close(minval(divisors), 0.1_wp/1.9_wp, 1.0e-14_wp, 'p ~ 2 w')
  end subroutine count_of_resonances

  !> s_j a_j + g_j + sum_k c_jk a_k conj(a_k) a_j = 0, j = 1, 2: a_j follows from
  !! x_k = a_k conj(a_k), and x_j |s_j + sum_k c_jk x_k|^2 = |g_j|^2 has nine solutions.
  subroutine all_steady_motions()
    integer, parameter :: row(16) = [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4]
    integer, parameter :: at(3, 16) = reshape([ &
                                              1, 0, 0, 0, 0, 0, 1, 1, 3, 1, 2, 4, &
                                              2, 0, 0, 0, 0, 0, 2, 1, 3, 2, 2, 4, &
                                              3, 0, 0, 0, 0, 0, 3, 3, 1, 3, 4, 2, &
                                              4, 0, 0, 0, 0, 0, 4, 3, 1, 4, 4, 2], [3, 16])
    type(family_type) :: family, again
    complex(wp), allocatable :: x(:, :)
    complex(wp) :: c(16), y(0:4), sides(4)
    real(wp) :: worst, part
    integer :: cancel, given_up, i, k, q, n, counts(2)

    if (.not. begin('all solutions of steady motions that only shift each other')) return
    cancel = 0
    call new_family(family, 4, .true., row, at, cancel)
    call check(size(family%solutions, 2) == 9, 'nine with coefficients at random')
    ! The second call uses the stored solutions and cannot be cancelled.
    given_up = 1
    call new_family(again, 4, .true., row, at, given_up)
    call check(size(again%solutions, 2) == 9, 'systems with the same terms are kept')
    call new_family(again, 4, .false., row, at, given_up)
    call check(size(again%solutions, 2) == 0, 'not those with other conjugates')
    allocate (x(4, size(family%solutions, 2)))
    worst = 0.0_wp
    counts = [huge(1), 0]
    do i = 1, 60
      part = i/60.0_wp
      c(:8) = [cmplx(-0.1_wp, 1.0_wp - 3.0_wp*part, wp), (0.5_wp, 0.1_wp), (0.01_wp, 1.0_wp), &
               (0.0_wp, 0.3_wp), (-0.2_wp, 0.7_wp), cmplx(0.3_wp, 0.2_wp*part, wp), &
               (0.02_wp, -0.4_wp), (0.0_wp, 0.8_wp)]
      c(9:) = conjg(c(:8))
      call family%solve_member(c, 1.0_wp, x, n, cancel)
      counts = [min(counts(1), n), max(counts(2), n)]
      do q = 1, n
        y = [(1.0_wp, 0.0_wp), x(:, q)]
        sides = (0.0_wp, 0.0_wp)
        do k = 1, 16
          sides(row(k)) = sides(row(k)) + c(k)*product(y(at(:, k)))
        end do
        worst = max(worst, maxval(abs(sides)))
      end do
    end do
    call check(all(counts == 9), 'nine of each member')
    call check(worst < 1.0e-10_wp, 'residuals')
  end subroutine all_steady_motions

  !> A weak quadratic term does not change the amplitude unit set by a strong cubic term.
  subroutine unit_of_amplitudes()
    type(slow_flow_type) :: flow
    real(wp) :: cubic_alone
    if (.not. begin('unit of amplitudes')) return
    flow%n_modes = 1
    flow%s = [(-0.01_wp, 1.0_wp)]
    flow%frame = [1.02_wp]
    flow%terms = [flow_term_type(1, [0, 0, 0], (0.0_wp, 1.0e-3_wp)), &
                  flow_term_type(1, [1, 1, -1], (0.0_wp, 0.5_wp))]
    cubic_alone = natural_unit(flow, [1])
    flow%terms = [flow%terms, flow_term_type(1, [1, -1, 0], (0.0_wp, 1.0e-5_wp))]
    call check_close(natural_unit(flow, [1]), cubic_alone, 1.0e-12_wp, 'unit')
  end subroutine unit_of_amplitudes

  !> The general equations, which a term of another kind with coefficient 0 selects, have the same
  !! steady motions as those of modes that are excited parametrically. Paths to a few of them fail.
  subroutine parametric_motions()
    type(slow_flow_type) :: flow, general
    type(steady_solver_type) :: solver, of_all
    type(status_type) :: status
    complex(wp) :: a(3, max_steady), expected(3, max_steady), rates(3)
    real(wp) :: worst
    integer :: cancel, i, k, n, m, n_expected, n_lost, n_more, n_moving, seed_size
    ! The debug build takes five times as long per system.
    integer, parameter :: n_systems = merge(100, 500, counting)

    if (.not. begin('steady motions of modes that are excited parametrically')) return
    call random_seed(size=seed_size)
    call random_seed(put=[(37*i, i=1, seed_size)])
    cancel = 0
    n_moving = 0
    n_lost = 0
    n_more = 0
    worst = 0.0_wp
    do i = 1, n_systems
      m = merge(3, 2, 5*i > 4*n_systems)
      call random_flow(m, flow)
      general = flow
      general%terms = [flow%terms, flow_term_type(2, [1, 0, 0], (0.0_wp, 0.0_wp))]
      call solver%solve(flow, a(:m, :), n, status, cancel)
      call check_ok(status)
      call of_all%solve(general, expected(:m, :), n_expected, status, cancel)
      call check_ok(status)
      do k = 1, n_expected
        if (.not. is_among(expected(:m, k), a(:m, :n))) n_lost = n_lost + 1
      end do
      n_more = n_more + n - n_expected
      n_moving = n_moving + count(abs(a(2, :n)) > 0.0_wp)
      do k = 1, n
        call flow%rates(0.0_wp, a(:m, k), rates(:m))
        worst = max(worst, maxval(abs(rates(:m)))/(1.0_wp + maxval(abs(a(:m, k)))**3))
      end do
    end do
    call check(n_lost == 0, 'all motions of the general equations')
    call check(n_more <= 8, 'few others')
    call check(worst < 1.0e-11_wp, 'residuals')
    call check(n_moving > n_systems, 'modes move in many')
  end subroutine parametric_motions

  pure logical function is_among(one, all_of_them)
    complex(wp), intent(in) :: one(:), all_of_them(:, :)
    is_among = any(maxval(abs(all_of_them - spread(one, 2, size(all_of_them, 2))), 1) &
                   <= 1.0e-6_wp*maxval(abs(one)))
  end function is_among

  !> A driven mode 1 and other modes with any of the three kinds of excitation.
  subroutine random_flow(n, flow)
    integer, intent(in) :: n
    type(slow_flow_type), intent(out) :: flow
    real(wp) :: chance, twice
    integer :: j, k, m

    flow%n_modes = n
    flow%frame = [(1.0_wp, j=1, n)]
    allocate (flow%s(n))
    call random_number(twice)
    flow%terms = [flow_term_type(1, 0, 0.3_wp*anywhere(), loads=[1, 0, 0])]
    do j = 1, n
      call random_number(chance)
      flow%s(j) = cmplx(-0.02_wp - 0.1_wp*chance, 1.0_wp, wp) + (0.0_wp, 0.5_wp)*real(anywhere())
      do k = 1, n
        flow%terms = [flow%terms, flow_term_type(j, [j, k, -k], anywhere())]
      end do
      if (j == 1) cycle
      call random_number(chance)
      m = int(3.0_wp*chance)
      select case (m)
      case (0)
        flow%terms = [flow%terms, flow_term_type(j, [-j, 0, 0], 0.3_wp*anywhere(), &
                                                 loads=[1, 1, 0])]
      case (1)
        flow%terms = [flow%terms, flow_term_type(j, [1, -j, 0], anywhere())]
        if (n == 2 .and. twice > 0.3_wp) flow%terms = &
          [flow%terms, flow_term_type(1, [j, j, 0], anywhere())]
      case default
        flow%terms = [flow%terms, flow_term_type(j, [1, 1, -j], anywhere())]
        if (n == 2 .and. twice > 0.3_wp) flow%terms = &
          [flow%terms, flow_term_type(1, [j, j, -1], anywhere())]
      end select
    end do
  end subroutine random_flow

  complex(wp) function anywhere()
    real(wp) :: parts(2)
    call random_number(parts)
    anywhere = cmplx(2.0_wp*parts(1) - 1.0_wp, 2.0_wp*parts(2) - 1.0_wp, wp)
  end function anywhere

end module test_scales
