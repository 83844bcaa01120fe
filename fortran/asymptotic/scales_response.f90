!> Steady motions along values of the frequency or the amplitude of a load.
module viscovib_scales_response
  use viscovib_flow_stability, only: flow_eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_linear_modes, only: find_modes
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_error, only: steady_error
  use viscovib_scales_motion, only: harmonic_of, n_sizes
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_steady_states, only: max_steady, new_steady_solver, steady_solver_type
  implicit none
  private

  public :: response_along, steady_points_type

  integer, parameter, public :: vary_frequency = 1, vary_amplitude = 2

  !> Steady motions, a column each: which value they belong to, amplitudes and frequencies
  !! of the modes, eigenvalues, first harmonic of the load's frequency in each coordinate,
  !! u = Re X exp(i p t), and what the terms of each order can add up to, shape (n_sizes).
  type :: steady_points_type
    integer :: n = 0
    integer, allocatable :: value(:)
    complex(wp), allocatable :: a(:, :), eigenvalues(:, :), harmonic(:, :)
    real(wp), allocatable :: frame(:, :), sizes(:, :)
    !> Where asked for, errors of the harmonic and of the whole motion in each coordinate.
    real(wp), allocatable :: harmonic_errors(:, :), motion_errors(:, :)
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
    integer, intent(inout), volatile :: cancel
    type(polynomial_form_type) :: here
    type(multiple_scales_type) :: scales
    type(steady_solver_type) :: solver
    complex(wp) :: a(form%n_modes(), max_steady), exponents(form%n_modes())
    complex(wp), dimension(form%n, form%n_modes()) :: right, left
    real(wp) :: reference
    integer :: i, k, n_found
    logical :: near, ready

    call reserve(points, form%n_modes(), form%n_dof, 3*size(values))
    if (load < 1 .or. load > size(form%drives)) then
      call fail(status, status_input_error, 'load', 'load = '//show(load)//': must be 1 to ' &
                //show(size(form%drives)))
      return
    end if
    call form%copy_to(here)
    if (vary == vary_frequency) then
      call find_modes(form, exponents, right, left, status)
      if (status%failed()) return
      call set_value(nearest_to_mode(aimag(exponents), left, form%load(:, load), values))
    else if (any(abs(values) > 0.0_wp)) then
      call set_value(values(maxloc(abs(values), 1)))
    end if
    reference = here%drives(load)
    if (.not. any(abs(here%load(:, load)) > 0.0_wp)) then
      call fail(status, status_input_error, 'load', 'load '//show(load)//' has no amplitude: ' &
                //'there is nothing to respond to')
      return
    end if
    call new_multiple_scales(scales, here, tolerance, .true., status)
    if (status%failed()) return
    near = any(scales%normal%weak == load)
    ready = .false.
    do i = 1, size(values)
      if (cancel /= 0) return
      if (near) then
        call move_load(values(i))
      else
        call set_value(values(i))
        call new_multiple_scales(scales, here, tolerance, .true., status)
        ready = .false.
      end if
      if (status%failed()) return
      if (.not. scales%flow%autonomous) then
        call fail(status, status_input_error, 'values', 'values (value '//show(i)//') = ' &
                  //show(values(i))//': the loads and the resonances have frequencies that no ' &
                  //'steady motion joins: see modulation, or count fewer as resonant by a ' &
                  //'smaller tolerance')
        return
      end if
      if (.not. ready) call new_steady_solver(solver, scales%flow, status, cancel)
      if (status%failed()) return
      ready = .true.
      call solver%solve(scales%flow, a, n_found, cancel)
      do k = 1, n_found
        call add_point(i, a(:, k))
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

    !> Only what load `load` does by itself changes with it while it is near a mode.
    subroutine move_load(value)
      real(wp), intent(in) :: value
      integer :: m
      scales%form%drives(load) = merge(value, scales%form%drives(load), vary == vary_frequency)
      if (vary == vary_amplitude) scales%form%load(:, load) = scales%rows*value*direction()
      call scales%normal%answer_load(scales%form, load, scales%form%drives(load), &
                                     scales%normal%u_load(:, load), &
                                     scales%normal%g_load(:, load), status, reference)
      if (status%failed()) return
      do m = 1, size(scales%flow%terms)
        associate (t => scales%flow%terms(m))
          if (any(t%at /= 0) .or. t%loads(1) /= load) cycle
          t%coefficient = scales%normal%g_load(t%row, load)
          t%drive = scales%form%drives(load)
        end associate
      end do
      call scales%flow%turn_frame()
    end subroutine move_load

    subroutine add_point(i, amplitudes)
      integer, intent(in) :: i
      complex(wp), intent(in) :: amplitudes(:)
      if (points%n == size(points%value)) then
        call reserve(points, form%n_modes(), form%n_dof, 2*points%n + 1)
      end if
      points%n = points%n + 1
      associate (m => points%n)
        points%value(m) = i
        points%a(:, m) = amplitudes*scales%amplitude_units
        points%frame(:, m) = scales%flow%frame
        call flow_eigenvalues(scales%flow, amplitudes, points%eigenvalues(:, m))
        call harmonic_of(scales, amplitudes, scales%form%drives(load), points%harmonic(:, m), &
                         points%sizes(:, m))
        if (with_errors) then
          call steady_error(scales, form%full, amplitudes, scales%form%drives(load), &
                            points%harmonic_errors(:, m), points%motion_errors(:, m))
        end if
      end associate
    end subroutine add_point

  end subroutine response_along

  !> Room for so many points; those there are stay.
  pure subroutine reserve(points, n_modes, n_dof, room)
    type(steady_points_type), intent(inout) :: points
    integer, intent(in) :: n_modes, n_dof, room
    type(steady_points_type) :: more
    allocate (more%value(room), more%a(n_modes, room), more%eigenvalues(2*n_modes, room), &
              more%harmonic(n_dof, room), more%frame(n_modes, room), more%sizes(n_sizes, room), &
              more%harmonic_errors(n_dof, room), more%motion_errors(n_dof, room))
    more%n = points%n
    if (points%n > 0) then
      associate (m => points%n)
        more%value(:m) = points%value(:m)
        more%a(:, :m) = points%a(:, :m)
        more%eigenvalues(:, :m) = points%eigenvalues(:, :m)
        more%harmonic(:, :m) = points%harmonic(:, :m)
        more%frame(:, :m) = points%frame(:, :m)
        more%sizes(:, :m) = points%sizes(:, :m)
        more%harmonic_errors(:, :m) = points%harmonic_errors(:, :m)
        more%motion_errors(:, :m) = points%motion_errors(:, :m)
      end associate
    end if
    points = more
  end subroutine reserve

  !> The value that lies nearest to a mode that the load drives.
  pure real(wp) function nearest_to_mode(omega, left, load, values)
    !> Frequencies and left vectors of the modes, a column each.
    real(wp), intent(in) :: omega(:), load(:), values(:)
    complex(wp), intent(in) :: left(:, :)
    real(wp) :: distance, best
    integer :: i, j
    best = huge(best)
    nearest_to_mode = values(1)
    do j = 1, size(omega)
      if (abs(sum(left(:, j)*load)) <= 1.0e-12_wp*maxval(abs(left(:, j)))*maxval(abs(load))) cycle
      do i = 1, size(values)
        distance = abs(values(i)/omega(j) - 1.0_wp)
        if (distance >= best) cycle
        best = distance
        nearest_to_mode = values(i)
      end do
    end do
  end function nearest_to_mode

end module viscovib_scales_response
