!> A motion in time relative to its base, with all coordinates, at the states kept and before.
module viscovib_known_motion
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_constants, only: imaginary_unit
  use viscovib_element_forces, only: sampled_motion
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_motion_balance, only: panel_points
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: move_subject
  use viscovib_timed_polynomials, only: timed_polynomials
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: max_kept, transient_job
  implicit none
  private

  public :: add_wave, base_at, know_motion, known_motion, load_at, own_forces, repeat_motion

  type, extends(sampled_motion) :: known_motion
    !> Displacements, velocities and accelerations by the base, shape (n_dof, n, 3).
    real(wp), allocatable :: moved(:, :, :)
  end type known_motion

contains

  !> The motion of all coordinates, and forces of laws if states do not give them.
  subroutine know_motion(motion, subject, nu, trajectory, known, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    type(known_motion), intent(out) :: known
    type(status_type), intent(out) :: status
    type(trajectory_type) :: again
    real(wp), allocatable :: times(:)
    integer, allocatable :: points(:)
    logical :: has_laws
    integer :: i, n

    call set_ok(status)
    n = size(motion%initial)/2
    known%times = trajectory%t
    has_laws = own_forces(motion, subject)
    if (subject%has_kernels()) then
      call find_panels(trajectory, known%ends, times, points)
      call repeat_motion(motion, subject, nu, trajectory, times, has_laws, again, status)
      if (status%failed()) return
      call relative(subject, nu, again, points, known%panel_u, known%panel_rate)
      if (has_laws) known%panel_laws = transpose(again%accelerations(n + 1:, points))
      known%held = [(0.0_wp, i=1, n)]
      if (allocated(motion%held)) known%held = motion%held
    end if
    points = [(i, i=1, size(trajectory%t))]
    if (subject%is_structure .or. has_laws) then
      call repeat_motion(motion, subject, nu, trajectory, trajectory%t, has_laws, again, status)
      if (status%failed()) return
      call relative(subject, nu, again, points, known%u, known%rate)
      if (has_laws) known%laws = transpose(again%accelerations(n + 1:, :))
    else
      call relative(subject, nu, trajectory, points, known%u, known%rate)
    end if
    call base_at(subject, nu, trajectory%t, known%moved)
  end subroutine know_motion

  !> True if a state does not give the forces, because laws have surfaces, elements have states or
  !! forces remember by coordinates: the equations then give them along the motion.
  logical function own_forces(motion, subject)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in) :: subject
    integer :: i
    own_forces = .false.
    if (subject%is_pendulum .or. subject%is_turning) return
    select type (motion)
    type is (hereditary_job)
      return
    end select
    associate (system => subject%polynomial)
      own_forces = any(system%kernel_of > 0) .or. any([(system%laws(i)%state > 0 .or. &
        system%laws(i)%program%n_surfaces() > 0, i=1, size(system%laws))])
      own_forces = own_forces .or. allocated(system%shaft)
    end associate
  end function own_forces

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
      call fail(status, status_input_error, 'transient', '&transient: accelerations and forces ' &
                //'need '//show(size(times))//' states of the motion, too many: use a shorter run')
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
    call fail(status, status_input_error, 'transient', '&transient: the motion ended before its ' &
              //'last state when it was repeated for accelerations and forces')
  end subroutine repeat_motion

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
  subroutine relative(subject, nu, trajectory, points, u, rate)
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    integer, intent(in) :: points(:)
    real(wp), allocatable, intent(out) :: u(:, :), rate(:, :)
    real(wp), allocatable :: moved(:, :, :)
    call base_at(subject, nu, trajectory%t, moved)
    allocate (u, source=transpose(trajectory%states(1::2, points) - moved(:, points, 1)))
    allocate (rate, source=transpose(trajectory%states(2::2, points) - moved(:, points, 2)))
  end subroutine relative

  !> What the base moves the coordinates by, their velocities and accelerations, (n_dof, n, 3).
  subroutine base_at(subject, nu, t, moved)
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu, t(:)
    real(wp), allocatable, intent(out) :: moved(:, :, :)
    type(load_type), pointer :: load
    integer :: i, k

    load => subject%load
    if (subject%is_structure) load => subject%model%load
    associate (direction => subject%base_direction())
      allocate (moved(size(direction), size(t), 3), source=0.0_wp)
      if (load%has_table()) then
        ! States are relative to a base whose acceleration is given.
        do i = 1, size(t)
          moved(:, i, 3) = matmul(load%floors, load%table%at(t(i)))
        end do
      end if
      if (.not. load%moves_base()) return
      do k = 1, size(load%orders)
        call add_wave(load%orders(k)*nu, load%moved(:, k) + direction*load%base(k), t, moved)
      end do
    end associate
  end subroutine base_at

  !> Add Im a exp(i w t), its derivative and its second derivative, shape (size(a), size(t), 3).
  pure subroutine add_wave(w, a, t, moved)
    real(wp), intent(in) :: w, t(:)
    complex(wp), intent(in) :: a(:)
    real(wp), intent(inout) :: moved(:, :, :)
    complex(wp) :: wave
    integer :: i
    do i = 1, size(t)
      wave = exp(imaginary_unit*(w*t(i)))
      moved(:, i, 1) = moved(:, i, 1) + aimag(a*wave)
      moved(:, i, 2) = moved(:, i, 2) + w*real(a*wave)
      moved(:, i, 3) = moved(:, i, 3) - w**2*aimag(a*wave)
    end do
  end subroutine add_wave

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

end module viscovib_known_motion
