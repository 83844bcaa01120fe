!> Steady motions along values of the frequency or the amplitude of a load.
module viscovib_scales_response
  use viscovib_flow_stability, only: flow_eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales, reach_of
  use viscovib_normal_products, only: reach_type
  use viscovib_polynomial_form, only: full_system_type, polynomial_form_type
  use viscovib_resonant_terms, only: left_out, wants_more
  use viscovib_resting_modes, only: far_growth, resting_growth
  use viscovib_scales_error, only: steady_error
  use viscovib_scales_motion, only: harmonic_of, n_sizes
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_steady_states, only: max_steady, new_steady_solver, steady_solver_type
  use viscovib_stopping, only: begin_piece, is_set, stop_wanted
  implicit none
  private

  public :: response_along, steady_points_type

  integer, parameter, public :: vary_frequency = 1, vary_amplitude = 2
  integer, parameter :: max_rounds = 4
  !> What the slow flow lacks are terms of fourth order and above: they move a motion by e where
  !! they change rates by |eigenvalue| e, and eigenvalues by their own order times that over the
  !! amplitude. With twice that 3 of 13 000 random motions had a sign of their growth that Floquet's
  !! did not have and that was told as sure.
  real(wp), parameter :: slopes_of_left_out = 8.0_wp
  !> Motions count where each order is at most this part of the one before.
  real(wp), parameter :: least_fall = 0.3_wp

  !> Steady motions, a column each: which value they belong to, amplitudes and frequencies
  !! of the modes, eigenvalues, first harmonic of the load's frequency in each coordinate,
  !! u = Re X exp(i p t), and what the terms of each order can add up to, shape (n_sizes).
  type :: steady_points_type
    integer :: n = 0
    integer, allocatable :: value(:)
    complex(wp), allocatable :: a(:, :), eigenvalues(:, :), harmonic(:, :)
    real(wp), allocatable :: frame(:, :), sizes(:, :)
    !> Largest influence of what is not among the resonant terms (`viscovib_resonance_choice`).
    real(wp), allocatable :: left_out(:)
    !> Growth of modes at rest by what is of the order that follows, or too far to be in the
    !! modulation equations; -huge: nothing is near.
    real(wp), allocatable :: resting(:)
    !> Where asked for, errors of the harmonic and of the whole motion in each coordinate.
    real(wp), allocatable :: harmonic_errors(:, :), motion_errors(:, :)
    !> And of the largest growth.
    real(wp), allocatable :: growth_errors(:)
  end type steady_points_type

contains

  subroutine response_along(form, load, vary, values, tolerance, with_errors, points, status, &
                            cancel)
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: load, vary
    real(wp), intent(in) :: values(:), tolerance
    !> Estimate errors too: some ten times the work.
    logical, intent(in) :: with_errors
    type(steady_points_type), intent(out) :: points
    type(status_type), intent(out) :: status
    integer, intent(inout) :: cancel
    type(polynomial_form_type) :: here
    type(multiple_scales_type) :: scales
    type(steady_solver_type) :: solver
    type(reach_type) :: reach
    complex(wp) :: a(form%n_modes(), max_steady)
    real(wp) :: given
    integer :: i, k, n_found
    logical :: moves_rest

    call reserve(points, form%n_modes(), form%n_dof, 3*size(values))
    if (load < 1 .or. load > size(form%drives)) then
      call fail(status, status_input_error, 'load', 'load = '//show(load)//': must be 1 to ' &
                //show(size(form%drives)))
      return
    end if
    call set_ok(status)
    call form%copy_to(here)
    given = form%load(maxloc(abs(form%load(:, load)), 1), load)
    if (vary == vary_amplitude .and. any(abs(values) > 0.0_wp)) then
      call set_value(values(maxloc(abs(values), 1)))
    end if
    if (.not. any(abs(here%load(:, load)) > 0.0_wp)) then
      call fail(status, status_input_error, 'load', 'load '//show(load)//' has no amplitude: ' &
                //'there is nothing to respond to')
      return
    end if
    moves_rest = .not. here%drives(load) > 0.0_wp .and. vary == vary_amplitude
    do i = 1, size(values)
      if (is_set(cancel) .or. stop_wanted()) return
      call begin_piece()
      ! Nothing here depends on the other values.
      call set_value(values(i))
      if (i == 1 .or. moves_rest) call reach_of(here, reach, status)
      if (status%failed()) return
      call find_steady(here, tolerance, reach, scales, solver, a, n_found, status, cancel)
      if (.not. status%failed() .and. .not. scales%flow%autonomous) call refuse_value(i)
      if (status%failed()) return
      if (vary == vary_amplitude) scales%load_factor(load) = values(i)/given
      do k = 1, n_found
        call add_point(points, i, scales, here, form%full, load, tolerance, reach, with_errors, &
                       a(:, k))
      end do
    end do

  contains

    subroutine set_value(value)
      real(wp), intent(in) :: value
      if (vary == vary_frequency) then
        here%drives(load) = value
      else
        here%load(:, load) = value*direction()
      end if
    end subroutine set_value

    !> The load with its largest entry 1.
    function direction() result(unit)
      real(wp) :: unit(form%n)
      unit = form%load(:, load)
      if (any(abs(unit) > 0.0_wp)) unit = unit/unit(maxloc(abs(unit), 1))
    end function direction

    subroutine refuse_value(i)
      integer, intent(in) :: i
      call fail(status, status_input_error, 'values', 'values (value '//show(i)//') = ' &
                //show(values(i))//': no steady motion fits the frequencies of the loads and of ' &
                //'the resonances: see modulation, or count fewer as resonant by a ' &
                //'smaller tolerance')
    end subroutine refuse_value

  end subroutine response_along

  !> Add a steady motion at value i, of the equations `here`, with its stability and errors.
  subroutine add_point(points, i, scales, here, full, load, tolerance, reach, with_errors, &
                       amplitudes)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: i, load
    type(multiple_scales_type), intent(inout) :: scales
    type(polynomial_form_type), intent(in) :: here
    class(full_system_type), intent(in), optional :: full
    real(wp), intent(in) :: tolerance
    type(reach_type), intent(in) :: reach
    logical, intent(in) :: with_errors
    complex(wp), intent(in) :: amplitudes(:)
    real(wp) :: by_far, left

    if (points%n == size(points%value)) then
      call reserve(points, here%n_modes(), here%n_dof, 2*points%n + 1)
    end if
    points%n = points%n + 1
    associate (m => points%n)
      points%value(m) = i
      points%a(:, m) = amplitudes*scales%amplitude_units
      points%frame(:, m) = scales%flow%frame
      call flow_eigenvalues(scales%flow, amplitudes, points%eigenvalues(:, m))
      call harmonic_of(scales, amplitudes, scales%form%drives(load), points%harmonic(:, m), &
                       points%sizes(:, m))
      points%left_out(m) = left_out(scales%normal, abs(amplitudes))
      call resting_growth(scales, full, amplitudes, points%resting(m))
      call far_growth(scales, full, here, tolerance, reach, amplitudes, by_far, left)
      points%resting(m) = max(points%resting(m), by_far)
      points%left_out(m) = max(points%left_out(m), left)
      if (with_errors) then
        call steady_error(scales, full, amplitudes, scales%form%drives(load), &
                          points%harmonic_errors(:, m), points%motion_errors(:, m))
        points%growth_errors(m) = slopes_of_left_out*maxval(abs(points%eigenvalues(:, m))) &
                                  *maxval(points%motion_errors(:, m)*points%sizes(4, m) &
                                          /scales%units(:here%n_dof)) &
                                  /max(points%sizes(1, m), tiny(1.0_wp))
      end if
    end associate
  end subroutine add_point

  !> All steady motions, resonances chosen by what their terms do at the largest of those in range.
  subroutine find_steady(form, tolerance, reach, scales, solver, a, n_found, status, cancel)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    type(reach_type), intent(in) :: reach
    type(multiple_scales_type), intent(out) :: scales
    !> Keeps what it knows of equations with the same terms.
    type(steady_solver_type), intent(inout) :: solver
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    type(status_type), intent(out) :: status
    integer, intent(inout) :: cancel
    real(wp) :: expected(form%n_modes()), most(form%n_modes()), sizes(n_sizes)
    complex(wp) :: harmonic(form%n_dof)
    integer :: round, k

    expected = 0.0_wp
    n_found = 0
    do round = 1, max_rounds
      call new_multiple_scales(scales, form, tolerance, .true., status, reach, expected)
      if (status%failed() .or. .not. scales%flow%autonomous) return
      call new_steady_solver(solver, scales%flow, status, cancel)
      if (status%failed()) return
      call solver%solve(scales%flow, a, n_found, cancel)
      most = expected
      do k = 1, n_found
        call harmonic_of(scales, a(:, k), 1.0_wp, harmonic, sizes)
        if (max(sizes(2), sqrt(sizes(3)*sizes(1))) <= least_fall*sizes(1)) then
          most = max(most, abs(a(:, k)))
        end if
      end do
      if (.not. wants_more(scales%normal, most)) return
      expected = most
    end do
  end subroutine find_steady

  !> Room for so many points; those there are stay.
  pure subroutine reserve(points, n_modes, n_dof, room)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: n_modes, n_dof, room
    type(steady_points_type) :: more
    allocate (more%value(room), more%a(n_modes, room), more%eigenvalues(2*n_modes, room), &
              more%harmonic(n_dof, room), more%frame(n_modes, room), more%sizes(n_sizes, room), &
              more%left_out(room), more%resting(room), &
              more%harmonic_errors(n_dof, room), more%motion_errors(n_dof, room), &
              more%growth_errors(room))
    more%n = points%n
    if (points%n > 0) then
      associate (m => points%n)
        more%value(:m) = points%value(:m)
        more%a(:, :m) = points%a(:, :m)
        more%eigenvalues(:, :m) = points%eigenvalues(:, :m)
        more%harmonic(:, :m) = points%harmonic(:, :m)
        more%frame(:, :m) = points%frame(:, :m)
        more%sizes(:, :m) = points%sizes(:, :m)
        more%left_out(:m) = points%left_out(:m)
        more%resting(:m) = points%resting(:m)
        more%harmonic_errors(:, :m) = points%harmonic_errors(:, :m)
        more%motion_errors(:, :m) = points%motion_errors(:, :m)
        more%growth_errors(:m) = points%growth_errors(:m)
      end associate
    end if
    points = more
  end subroutine reserve

end module viscovib_scales_response
