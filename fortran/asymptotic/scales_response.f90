! Optimize: -O2 -fstack-arrays
!> Steady motions for values of the frequency or the amplitude of a load. If the modulation
!! equations are not autonomous in any frame: their quasi-periodic attractors.
module viscovib_scales_response
  use viscovib_beating_flow, only: beating_flow_type, beats_found
  use viscovib_beating_motion, only: beating_errors, beating_motion_type, find_beating_motion
  use viscovib_kinds, only: wp
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales, reach_of
  use viscovib_normal_orders, only: answer_triples
  use viscovib_normal_products, only: reach_type
  use viscovib_polynomial_form, only: full_system_type, polynomial_form_type
  use viscovib_resonant_terms, only: left_out, wants_more
  use viscovib_resting_modes, only: far_growth, resting_error, resting_growth
  use viscovib_scales_error, only: steady_error
  use viscovib_scales_motion, only: harmonic_of, n_sizes
  use viscovib_slow_flow, only: flow_eigenvalues
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_steady_states, only: max_steady, steady_solver_type
  use viscovib_stopping, only: begin_piece, is_set, stop_wanted
  implicit none
  private

  public :: response_along, steady_points_type

  integer, parameter, public :: vary_frequency = 1, vary_amplitude = 2
  integer, parameter :: max_rounds = 4
  !> The slow flow neglects terms of fourth order and above. If these shift a motion by e, they
  !! change its rates by |eigenvalue| e, and eigenvalues by the terms' order times e/amplitude. The
  !! factor is twice this bound.
  real(wp), parameter :: slopes_of_left_out = 8.0_wp
  !> Largest ratio of successive orders up to which motions are accepted.
  real(wp), parameter :: least_fall = 0.3_wp

  !> Steady motions, one column each: index of the value, amplitudes and frequencies
  !! of the modes, eigenvalues, first harmonic of the load's frequency in each coordinate,
  !! u = Re X exp(i p t), and upper bounds of the terms of each order, shape (n_sizes).
  type :: steady_points_type
    integer :: n = 0
    integer, allocatable :: value(:)
    complex(wp), allocatable :: a(:, :), eigenvalues(:, :), harmonic(:, :)
    real(wp), allocatable :: frame(:, :), sizes(:, :)
    !> Largest influence of terms that are not resonant (`viscovib_normal_products`).
    real(wp), allocatable :: left_out(:)
    !> Growth of modes at rest by terms of the next order or too far from a mode for the modulation
    !! equations; -huge: there are no such terms.
    real(wp), allocatable :: resting(:)
    !> For each value: whether a subharmonic or superharmonic motion may be missing, since its
    !! product is not constant in the frame.
    logical, allocatable :: may_lack(:)
    !> If requested, errors of the harmonic and of the whole motion in each coordinate.
    real(wp), allocatable :: harmonic_errors(:, :), motion_errors(:, :)
    !> Error of the largest growth.
    real(wp), allocatable :: growth_errors(:)
    !> Number of beats of each motion, 0 if it is steady. Lines of all beating motions in sequence:
    !! index of the point, frequency, X, shape (n_dof, n_lines).
    integer, allocatable :: beats(:), line_of(:)
    real(wp), allocatable :: line_frequency(:)
    complex(wp), allocatable :: line(:, :)
  end type steady_points_type

contains

  subroutine response_along(form, load, vary, values, tolerance, with_errors, points, status, &
                            cancel)
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: load, vary
    real(wp), intent(in) :: values(:), tolerance
    !> Estimate errors, at about ten times the cost.
    logical, intent(in) :: with_errors
    type(steady_points_type), intent(out) :: points
    type(status_type), intent(out) :: status
    integer, intent(inout) :: cancel
    type(polynomial_form_type) :: here
    type(multiple_scales_type) :: scales, wide
    type(steady_solver_type) :: solver
    type(reach_type) :: reach
    complex(wp) :: a(form%n_modes(), max_steady)
    real(wp) :: given
    integer :: i, k, n_found, first
    logical :: moves_rest, replaced, stands

    allocate (points%line_of(0), points%line_frequency(0), points%line(form%n_dof, 0))
    allocate (points%may_lack(size(values)), source=.false.)
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
      ! Values are independent of each other.
      call set_value(values(i))
      if (i == 1 .or. moves_rest) call reach_of(here, reach, status)
      if (status%failed()) return
      call find_steady(here, tolerance, reach, scales, solver, a, n_found, status, cancel)
      if (status%failed()) return
      points%may_lack(i) = any(scales%normal%candidates%lost)
      if (vary == vary_amplitude) scales%load_factor(load) = values(i)/given
      first = points%n + 1
      do k = 1, n_found
        call add_point(points, i, scales, here, form%full, load, tolerance, reach, with_errors, &
                       a(:, k), wide)
      end do
      stands = .not. any(points%left_out(first:points%n) > least_fall)
      if (.not. stands) stands = .not. may_beat(scales)
      if (stands .and. scales%flow%autonomous) cycle
      call add_beats(points, i, first, here, form%full, load, scales%load_factor(load), tolerance, &
                     with_errors, a(:, :n_found), replaced, status, cancel)
      if (.not. status%failed() .and. .not. (scales%flow%autonomous .or. replaced)) then
        call refuse_value(i)
      end if
      if (status%failed()) return
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

    !> The load, scaled so that its largest entry is 1.
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
                       amplitudes, wide)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: i, load
    type(multiple_scales_type), intent(inout) :: scales
    type(polynomial_form_type), intent(in) :: here
    class(full_system_type), intent(in), optional :: full
    real(wp), intent(in) :: tolerance
    type(reach_type), intent(in) :: reach
    logical, intent(in) :: with_errors
    complex(wp), intent(in) :: amplitudes(:)
    !> As in `far_growth`.
    type(multiple_scales_type), intent(inout) :: wide
    type(status_type) :: status
    real(wp) :: by_far, left, growth, by_order

    if (points%n == size(points%value)) then
      call reserve(points, here%n_modes(), here%n_dof, 2*points%n + 1)
    end if
    points%n = points%n + 1
    associate (m => points%n)
      points%value(m) = i
      points%beats(m) = 0
      points%a(:, m) = amplitudes*scales%amplitude_units
      points%frame(:, m) = scales%flow%frame
      call flow_eigenvalues(scales%flow, amplitudes, points%eigenvalues(:, m))
      call harmonic_of(scales, amplitudes, scales%form%drives(load), points%harmonic(:, m), &
                       points%sizes(:, m))
      points%left_out(m) = left_out(scales%normal, abs(amplitudes))
      call resting_growth(scales, full, amplitudes, points%resting(m))
      growth = max(maxval(real(points%eigenvalues(:, m))), points%resting(m))
      call far_growth(scales, full, here, tolerance, reach, amplitudes, growth, wide, by_far, left)
      points%resting(m) = max(points%resting(m), by_far)
      points%left_out(m) = max(points%left_out(m), left)
      if (with_errors) then
        ! An error may move modes at rest. A product without a response remains 0.
        call answer_triples(scales%normal, scales%form, abs(amplitudes) > 0.0_wp, 3, status)
        call steady_error(scales, full, amplitudes, scales%form%drives(load), &
                          points%harmonic_errors(:, m), points%motion_errors(:, m))
        points%growth_errors(m) = slopes_of_left_out*maxval(abs(points%eigenvalues(:, m))) &
                                  *relative_error(points, m, scales)
        growth = max(maxval(real(points%eigenvalues(:, m))), points%resting(m))
        call resting_error(scales, full, amplitudes, growth, points%resting(m), by_order)
        points%growth_errors(m) = points%growth_errors(m) + by_order
      end if
    end associate
  end subroutine add_point

  !> Replace the points from `first` on whose equations are not autonomous in any frame by the
  !! attractors of the equations, computed from rest and from each of these points.
  subroutine add_beats(points, i, first, here, full, load, factor, tolerance, with_errors, &
                       steady, replaced, status, cancel)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: i, first, load
    type(polynomial_form_type), intent(in) :: here
    class(full_system_type), intent(in), optional :: full
    !> `factor`: factor of the varied load.
    real(wp), intent(in) :: factor, tolerance
    logical, intent(in) :: with_errors
    !> Amplitudes of the points from `first` on, in natural units.
    complex(wp), intent(in) :: steady(:, :)
    logical, intent(out) :: replaced
    type(status_type), intent(out) :: status
    integer, intent(inout) :: cancel
    type(multiple_scales_type) :: unframed
    type(beating_motion_type) :: motion
    complex(wp) :: starts(size(steady, 1), size(steady, 2) + 1)
    complex(wp) :: found(size(steady, 1), size(starts, 2))
    type(beating_flow_type), allocatable :: known(:)
    integer :: n, m, n_found

    call set_ok(status)
    replaced = .false.
    allocate (known(0))
    starts(:, 1) = (0.0_wp, 0.0_wp)
    n = 1
    do m = first, points%n
      if (.not. points%left_out(m) > least_fall) cycle
      n = n + 1
      starts(:, n) = steady(:, m - first + 1)
    end do
    n_found = 0
    do m = 1, n
      call find_beating_motion(here, tolerance, starts(:, m), known, unframed, motion, status, &
                               cancel)
      if (status%failed() .or. is_set(cancel)) return
      if (motion%flow%outcome /= beats_found) cycle
      if (is_among(motion%typical, found(:, :n_found))) cycle
      if (n_found == 0) call drop_beating(points, first)
      n_found = n_found + 1
      found(:, n_found) = motion%typical
      known = [known, motion%flow]
      unframed%load_factor(load) = factor
      call add_beating(points, i, unframed, full, load, motion, with_errors, cancel)
    end do
    replaced = n_found > 0
  end subroutine add_beats


  !> True if several loads act, or if some terms are not constant in the frame.
  pure logical function may_beat(scales)
    type(multiple_scales_type), intent(in) :: scales
    integer :: k
    may_beat = count([(scales%form%drives(k) > 0.0_wp .and. any(abs(scales%form%load(:, k)) &
                                                                > 0.0_wp), &
                       k=1, size(scales%form%drives))]) > 1
    may_beat = may_beat .or. any(scales%normal%candidates%turned_away)
  end function may_beat

  !> Remove the points from `first` on that are not steady motions.
  pure subroutine drop_beating(points, first)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: first
    type(steady_points_type) :: before
    integer :: m, last
    last = points%n
    points%n = first - 1
    do m = first, last
      if (points%left_out(m) > least_fall) cycle
      points%n = points%n + 1
      before = points
      call copy_points(before, points, [m], [points%n])
    end do
  end subroutine drop_beating

  !> True if the motion was found before.
  pure logical function is_among(typical, found)
    complex(wp), intent(in) :: typical(:), found(:, :)
    integer :: m
    is_among = .false.
    do m = 1, size(found, 2)
      is_among = is_among .or. maxval(abs(abs(typical) - abs(found(:, m)))) &
                 <= 1.0e-4_wp*maxval(abs(found(:, m)))
    end do
  end function is_among

  !> Add a beating motion at value i.
  subroutine add_beating(points, i, scales, full, load, motion, with_errors, cancel)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: i, load
    type(multiple_scales_type), intent(inout) :: scales
    class(full_system_type), intent(in), optional :: full
    type(beating_motion_type), intent(in) :: motion
    logical, intent(in) :: with_errors
    integer, intent(inout) :: cancel
    real(wp) :: p
    integer :: at

    if (points%n == size(points%value)) then
      call reserve(points, size(motion%typical), size(motion%x, 1), 2*points%n + 1)
    end if
    points%n = points%n + 1
    p = scales%form%drives(load)
    associate (m => points%n)
      points%value(m) = i
      points%a(:, m) = motion%typical*scales%amplitude_units
      points%frame(:, m) = scales%flow%frame
      points%eigenvalues(:, m) = motion%flow%growth
      points%sizes(:, m) = motion%sizes
      points%left_out(m) = motion%left_out
      points%beats(m) = motion%flow%lattice%d
      call resting_growth(scales, full, motion%typical, points%resting(m))
      at = minloc(abs(motion%frequency - p), 1)
      points%harmonic(:, m) = (0.0_wp, 0.0_wp)
      if (abs(motion%frequency(at) - p) <= 1.0e-9_wp*p) points%harmonic(:, m) = motion%x(:, at)
      points%line_of = [points%line_of, spread(m, 1, size(motion%frequency))]
      points%line_frequency = [points%line_frequency, motion%frequency]
      points%line = reshape([points%line, motion%x], &
                            [size(motion%x, 1), size(points%line_frequency)])
      if (with_errors) then
        call beating_errors(scales, full, motion, points%motion_errors(:, m), cancel)
        points%harmonic_errors(:, m) = points%motion_errors(:, m)
        points%growth_errors(m) = motion%flow%growth_error + slopes_of_left_out &
                                  *motion%flow%bent*relative_error(points, m, scales)
      end if
    end associate
  end subroutine add_beating

  !> The relative error of a motion.
  pure real(wp) function relative_error(points, m, scales)
    type(steady_points_type), intent(in) :: points
    integer, intent(in) :: m
    type(multiple_scales_type), intent(in) :: scales
    relative_error = maxval(points%motion_errors(:, m)*points%sizes(4, m) &
                            /scales%units(:scales%form%n_dof))/max(points%sizes(1, m), &
                                                                   tiny(1.0_wp))
  end function relative_error

  !> All steady motions; resonant terms are selected at the largest motion within the valid range.
  subroutine find_steady(form, tolerance, reach, scales, solver, a, n_found, status, cancel)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    type(reach_type), intent(in) :: reach
    type(multiple_scales_type), intent(inout) :: scales
    !> Reuses solutions of equations with the same terms.
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
      call solver%solve(scales%flow, a, n_found, status, cancel)
      if (status%failed()) return
      call answer_triples(scales%normal, scales%form, any(abs(a(:, :n_found)) > 0.0_wp, 2), 0, &
                          status)
      if (status%failed()) return
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

  !> Increase the capacity to `work` points; existing points are kept.
  pure subroutine reserve(points, n_modes, n_dof, work)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: n_modes, n_dof, work
    type(steady_points_type) :: more
    integer :: m
    allocate (more%value(work), more%a(n_modes, work), more%eigenvalues(2*n_modes, work), &
              more%harmonic(n_dof, work), more%frame(n_modes, work), more%sizes(n_sizes, work), &
              more%left_out(work), more%resting(work), &
              more%harmonic_errors(n_dof, work), more%motion_errors(n_dof, work), &
              more%growth_errors(work), more%beats(work))
    more%n = points%n
    more%may_lack = points%may_lack
    if (points%n > 0) call copy_points(points, more, [(m, m=1, points%n)], [(m, m=1, points%n)])
    if (allocated(points%line)) then
      more%line_of = points%line_of
      more%line_frequency = points%line_frequency
      more%line = points%line
    end if
    points = more
  end subroutine reserve

  pure subroutine copy_points(from, to, which, places)
    type(steady_points_type), intent(in) :: from
    type(steady_points_type), intent(inout) :: to
    integer, intent(in) :: which(:), places(:)
    to%value(places) = from%value(which)
    to%a(:, places) = from%a(:, which)
    to%eigenvalues(:, places) = from%eigenvalues(:, which)
    to%harmonic(:, places) = from%harmonic(:, which)
    to%frame(:, places) = from%frame(:, which)
    to%sizes(:, places) = from%sizes(:, which)
    to%left_out(places) = from%left_out(which)
    to%resting(places) = from%resting(which)
    to%harmonic_errors(:, places) = from%harmonic_errors(:, which)
    to%motion_errors(:, places) = from%motion_errors(:, which)
    to%growth_errors(places) = from%growth_errors(which)
    to%beats(places) = from%beats(which)
  end subroutine copy_points

end module viscovib_scales_response
