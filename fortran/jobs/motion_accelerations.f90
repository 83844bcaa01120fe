!> Accelerations of the states that a motion in time has kept, by the equations of motion.
!!
!! A motion whose laws have surfaces, or with memory of exponentials, is made once more, and its
!! equations give them on the side of each surface on which the motion is. Other oscillators are
!! looked at in all their coordinates; what they remember follows from the motion at the points of
!! its steps.
module viscovib_motion_accelerations
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_constants, only: imaginary_unit
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_motion_balance, only: accelerations_of, panel_points, recalled_along
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: move_subject
  use viscovib_timed_polynomials, only: timed_polynomials
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: max_kept, transient_job
  use viscovib_whole_structure, only: may_be_whole, whole_polynomial
  implicit none
  private

  public :: find_accelerations

contains

  !> Accelerations of the body, a column for each time of the trajectory.
  subroutine find_accelerations(motion, subject, nu, trajectory, accelerations, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load of a system without memory (rad/s).
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (subject%is_pendulum) then
      call of_pendulum(subject, trajectory, accelerations)
      return
    end if
    select type (motion)
    type is (hereditary_job)
      call by_balance(motion, subject, motion%nu, trajectory, accelerations, status)
    class default
      if (switches(subject%polynomial)) then
        call along_once_more(motion, subject, nu, trajectory, accelerations, status)
      else
        call by_balance(motion, subject, nu, trajectory, accelerations, status)
      end if
    end select
  end subroutine find_accelerations

  !> True if a state does not tell the forces: laws with surfaces, elements with states, memory.
  logical function switches(system)
    type(polynomial_type), intent(in) :: system
    integer :: i
    switches = any(system%kernel_of > 0) .or. any([(system%laws(i)%state > 0 .or. &
      system%laws(i)%program%n_surfaces() > 0, i=1, size(system%laws))])
  end function switches

  subroutine of_pendulum(subject, trajectory, accelerations)
    type(subject_type), intent(in) :: subject
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    real(wp) :: none(0)
    integer :: i
    associate (pendulum => subject%pendulum)
      allocate (accelerations(pendulum%n_dof, size(trajectory%t)))
      do i = 1, size(trajectory%t)
        call pendulum%law_forces(trajectory%t(i), trajectory%states(1::2, i), &
                                 trajectory%states(2::2, i), accelerations(:, i), none)
      end do
    end associate
  end subroutine of_pendulum

  subroutine along_once_more(motion, subject, nu, trajectory, accelerations, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status
    type(trajectory_type) :: again
    real(wp), allocatable :: moved(:, :, :)
    integer :: n

    call repeat_motion(motion, subject, nu, trajectory, trajectory%t, .true., again, status)
    if (status%failed()) return
    n = size(motion%initial)/2
    call base_at(subject%polynomial, subject%load, nu, trajectory%t, moved)
    allocate (accelerations(n, size(trajectory%t)))
    accelerations = again%accelerations(:n, :) + moved(:, :, 3)
  end subroutine along_once_more

  !> The same motion in the same steps, with all coordinates at other times.
  subroutine repeat_motion(motion, subject, nu, trajectory, times, accelerates, again, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu, times(:)
    type(trajectory_type), intent(in) :: trajectory
    logical, intent(in) :: accelerates
    type(trajectory_type), intent(out) :: again
    type(status_type), intent(out) :: status
    class(transient_job), allocatable :: own
    integer :: i

    if (real(size(times), wp)*size(motion%initial) > max_kept) then
      call fail(status, status_input_error, 'acceleration', "acceleration = 'yes': needs " &
                //show(size(times))//' states of the motion, too many: use a shorter run')
      return
    end if
    allocate (own, source=motion)
    own%dt = trajectory%h
    own%tolerance = 0.0_wp
    own%relative = 0.0_wp
    own%times = times
    own%save_every = 1
    own%last_only = .false.
    own%tail = 0.0_wp
    own%accelerates = accelerates
    if (allocated(trajectory%ends)) then
      own%ends = trajectory%ends
      own%made_by = trajectory%made_by
    end if
    if (allocated(own%watched)) deallocate (own%watched)
    call move_subject(own, subject, nu, [(i, i=1, size(motion%initial)/2)], again, status)
    if (status%failed() .or. size(again%t) == size(times)) return
    call fail(status, status_input_error, 'acceleration', "acceleration = 'yes': the motion " &
              //'ended before its last state when it was repeated')
  end subroutine repeat_motion

  !> By the balance of forces in all coordinates.
  subroutine by_balance(motion, subject, nu, trajectory, accelerations, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status
    type(polynomial_type), target :: whole
    class(oscillator_type), pointer :: system
    type(load_type), pointer :: load
    type(trajectory_type) :: again
    real(wp), allocatable :: moved(:, :, :), recalled(:, :), ends(:), times(:), panel_u(:, :), &
                             panel_rate(:, :), u(:, :), rate(:, :), a(:, :)
    integer, allocatable :: points(:)
    integer :: i
    logical :: singular

    load => subject%load
    call set_ok(status)
    if (.not. subject%is_structure) then
      system => subject%oscillator()
    else if (may_be_whole(subject%model)) then
      load => subject%model%load
      call whole_polynomial(subject%model, subject%structure%kernels, whole, status)
      system => whole
    else
      call fail(status, status_input_error, 'acceleration', "acceleration = 'yes': is for " &
                //'structures of at most 512 coordinates, all with mass, not reduced, without ' &
                //'loss factors')
    end if
    if (status%failed()) return
    allocate (recalled(size(trajectory%t), system%n_memory()), source=0.0_wp)
    if (any(system%kernel_of > 0)) then
      call find_panels(trajectory, ends, times, points)
      call repeat_motion(motion, subject, nu, trajectory, times, .false., again, status)
      if (status%failed()) return
      call relative(system, load, nu, again, points, panel_u, panel_rate)
      call recalled_along(system, ends, panel_u, panel_rate, motion%held, trajectory%t, recalled)
    end if
    points = [(i, i=1, size(trajectory%t))]
    if (subject%is_structure) then
      call repeat_motion(motion, subject, nu, trajectory, trajectory%t, .false., again, &
                         status)
      if (status%failed()) return
      call relative(system, load, nu, again, points, u, rate)
    else
      call relative(system, load, nu, trajectory, points, u, rate)
    end if
    call base_at(system, load, nu, trajectory%t, moved)
    allocate (a(size(u, 1), size(u, 2)))
    call accelerations_of(system, u, rate, load_at(system, load, nu, trajectory%t), &
                          recalled, a, singular)
    allocate (accelerations, source=transpose(a))
    accelerations = accelerations + moved(:, :, 3)
  end subroutine by_balance

  !> Ends of panels until the last state; times at their points, each once, and the place among
  !! these of every point.
  subroutine find_panels(trajectory, ends, times, points)
    type(trajectory_type), intent(in) :: trajectory
    real(wp), allocatable, intent(out) :: ends(:), times(:)
    integer, allocatable, intent(out) :: points(:)
    type(collocation_type) :: table
    type(mesh_type) :: mesh
    real(wp) :: until
    integer :: i, j, k, n

    call new_collocation(table, panel_points)
    until = max(trajectory%t(size(trajectory%t)), 1.0e-3_wp*trajectory%h)
    if (allocated(trajectory%ends)) then
      call new_mesh(mesh, trajectory%h, trajectory%ends, trajectory%made_by)
      n = int(trajectory%made_by(size(trajectory%made_by)))
      ends = [(mesh%start_of(int(i, i8)), i=0, n)]
      ends = [pack(ends, ends < until*(1.0_wp - 1.0e-14_wp)), until]
    else
      n = max(1, ceiling(until/trajectory%h*(1.0_wp - 1.0e-12_wp)))
      ends = [0.0_wp, (i*trajectory%h, i=1, n - 1), until]
    end if
    n = size(ends) - 1
    k = panel_points + 1
    allocate (times(n*k + 1), points(n*(k + 1)))
    do i = 1, n
      times((i - 1)*k + 1:i*k) = ends(i) + (ends(i + 1) - ends(i))*table%points(:panel_points)
      points((i - 1)*(k + 1) + 1:i*(k + 1)) = [((i - 1)*k + 1 + j, j=0, k)]
    end do
    times(n*k + 1) = until
  end subroutine find_panels

  !> Coordinates and rates relative to the base, a row for each of some states.
  subroutine relative(system, load, nu, trajectory, points, u, rate)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    integer, intent(in) :: points(:)
    real(wp), allocatable, intent(out) :: u(:, :), rate(:, :)
    real(wp), allocatable :: moved(:, :, :)
    call base_at(system, load, nu, trajectory%t, moved)
    allocate (u, source=transpose(trajectory%states(1::2, points) - moved(:, points, 1)))
    allocate (rate, source=transpose(trajectory%states(2::2, points) - moved(:, points, 2)))
  end subroutine relative

  !> What the base moves the coordinates by, their velocities and accelerations, (n_dof, n, 3).
  subroutine base_at(system, load, nu, t, moved)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, t(:)
    real(wp), allocatable, intent(out) :: moved(:, :, :)
    complex(wp) :: shift(system%n_dof()), wave
    real(wp) :: w
    integer :: i, k

    allocate (moved(system%n_dof(), size(t), 3), source=0.0_wp)
    if (load%has_table()) then
      ! States are relative to a base whose acceleration is given.
      do i = 1, size(t)
        moved(:, i, 3) = matmul(load%floors, load%table%at(t(i)))
      end do
    end if
    if (.not. load%moves_base()) return
    do k = 1, size(load%orders)
      w = load%orders(k)*nu
      shift = load%shift(system, k)
      do i = 1, size(t)
        wave = exp(imaginary_unit*(w*t(i)))
        moved(:, i, 1) = moved(:, i, 1) + aimag(shift*wave)
        moved(:, i, 2) = moved(:, i, 2) + w*real(shift*wave)
        moved(:, i, 3) = moved(:, i, 3) - w**2*aimag(shift*wave)
      end do
    end do
  end subroutine base_at

  !> The load on coordinates relative to the base, a row for each time.
  function load_at(system, load, nu, t) result(force)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, t(:)
    real(wp) :: force(size(t), system%n_dof())
    complex(wp) :: amplitude(system%n_dof())
    type(timed_polynomials) :: table
    integer :: i, k
    force = 0.0_wp
    if (load%has_table()) then
      call load%forces_in_time(table%breaks, table%pieces)
      do i = 1, size(t)
        force(i, :) = table%at(t(i))
      end do
    end if
    do k = 1, size(load%orders)
      amplitude = load%coefficient(system, load%orders(k), nu)
      do i = 1, size(t)
        force(i, :) = force(i, :) &
                      + aimag(amplitude*exp(imaginary_unit*(load%orders(k)*nu*t(i))))
      end do
    end do
  end function load_at

end module viscovib_motion_accelerations
