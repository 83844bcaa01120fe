!> A motion in time relative to its base, with all coordinates, at the states kept and before.
module viscovib_known_motion
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_base_motion, only: base_motion_type
  use viscovib_element_forces, only: sampled_motion
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_panels, only: add_past, panel_ends, panel_rows, panel_times, states_on_panels
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: move_subject
  use viscovib_time_load, only: time_load_type
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: max_kept, transient_job
  implicit none
  private

  public :: know_motion, known_motion, load_at, repeat_motion, waves_at

  type, extends(sampled_motion) :: known_motion
    !> Displacements, velocities and accelerations by the base, shape (n, n_dof, 3).
    real(wp), allocatable :: moved(:, :, :)
    !> Relative to the base, a row for each time; not allocated: a balance of forces gives them.
    real(wp), allocatable :: accelerations(:, :)
  contains
    procedure :: set_states
    procedure :: set_panels
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
    type(base_motion_type) :: base
    real(wp), allocatable :: ends(:), states(:, :), laws(:, :), held(:)
    logical :: has_laws
    integer :: i, n

    call set_ok(status)
    n = size(motion%initial)/2
    has_laws = own_forces(motion, subject)
    base = base_of(subject, nu)
    if (subject%is_structure .or. has_laws) then
      call repeat_motion(motion, subject, nu, trajectory, trajectory%t, has_laws, again, status)
      if (status%failed()) return
      call known%set_states(trajectory%t, again%states, base, n)
      if (has_laws) then
        known%laws = transpose(again%accelerations(n + 1:, :))
        known%accelerations = transpose(again%accelerations(:n, :))
      end if
    else
      call known%set_states(trajectory%t, trajectory%states, base, n)
    end if
    known%moved = known%moved + floors_at(subject, trajectory%t)
    ! Forces need the memory of each part, accelerations of the equations do not.
    if (.not. subject%has_kernels() .or. (has_laws .and. .not. motion%wants_forces)) return
    ends = panel_ends(trajectory%h, &
                      max(trajectory%t(size(trajectory%t)), 1.0e-3_wp*trajectory%h), &
                      trajectory%ends, trajectory%made_by)
    if (.not. (subject%is_structure .or. has_laws)) then
      call states_on_panels(ends, trajectory%t, trajectory%states, states)
    end if
    if (.not. allocated(states)) then
      call repeat_motion(motion, subject, nu, trajectory, panel_times(ends), has_laws, again, &
                         status)
      if (status%failed()) return
      call move_alloc(again%states, states)
      if (has_laws) laws = transpose(again%accelerations(n + 1:, :))
    end if
    held = [(0.0_wp, i=1, n)]
    if (allocated(motion%held)) held = motion%held
    call known%set_panels(ends, states, laws, base, [0.0_wp], reshape(held, [n, 1]))
  end subroutine know_motion

  !> States at times relative to the base.
  subroutine set_states(self, t, states, base, n)
    class(known_motion), intent(inout) :: self
    !> Ascending times, and states (u, u') of n coordinates and then others, a column for each.
    real(wp), intent(in) :: t(:), states(:, :)
    type(base_motion_type), intent(in) :: base
    integer, intent(in) :: n
    self%times = t
    self%moved = base%at_times(n, t)
    self%u = transpose(states(1:2*n:2, :)) - self%moved(:, :, 1)
    self%rate = transpose(states(2:2*n:2, :)) - self%moved(:, :, 2)
  end subroutine set_states

  !> The motion on panels, with the motion before t = 0.
  subroutine set_panels(self, ends, states, laws, base, before, moved)
    class(known_motion), intent(inout) :: self
    !> States as of `set_states` at `panel_times`; forces of laws there, a row for each time; not
    !! allocated: states give them.
    real(wp), intent(in) :: ends(:), states(:, :)
    real(wp), allocatable, intent(in) :: laws(:, :)
    type(base_motion_type), intent(in) :: base
    !> Times, ascending to 0, shape (m), and displacements at them, shape (n, m).
    real(wp), intent(in) :: before(:), moved(:, :)
    type(known_motion) :: once
    integer :: rows(size(panel_rows(size(ends) - 1)))
    integer :: n_old

    call once%set_states(panel_times(ends), states, base, size(moved, 1))
    rows = panel_rows(size(ends) - 1)
    self%ends = ends
    self%panel_u = once%u(rows, :)
    self%panel_rate = once%rate(rows, :)
    self%held = moved(:, 1)
    call add_past(before, moved, self%ends, self%panel_u, self%panel_rate)
    if (.not. allocated(laws)) return
    n_old = size(self%panel_u, 1) - size(rows)
    allocate (self%panel_laws(size(self%panel_u, 1), size(laws, 2)), &
              source=ieee_value(0.0_wp, ieee_quiet_nan))
    self%panel_laws(n_old + 1:, :) = laws(rows, :)
  end subroutine set_panels

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

  !> The motion of a base by the harmonics of the load.
  function base_of(subject, nu) result(base)
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    type(base_motion_type) :: base
    type(load_type), pointer :: load
    integer :: k

    load => subject%whole_load()
    if (.not. load%moves_base()) return
    associate (direction => subject%base_direction())
      base%frequencies = load%orders*nu
      allocate (base%amplitudes(size(direction), size(load%orders)))
      do k = 1, size(load%orders)
        base%amplitudes(:, k) = load%moved(:, k) + direction*load%base(k)
      end do
    end associate
  end function base_of

  !> What a base whose acceleration is given moves the coordinates by, shape (size(t), n_dof, 3):
  !! states are relative to such a base.
  function floors_at(subject, t) result(moved)
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: t(:)
    real(wp), allocatable :: moved(:, :, :)
    type(load_type), pointer :: load
    integer :: i

    load => subject%whole_load()
    allocate (moved(size(t), size(subject%base_direction()), 3), source=0.0_wp)
    if (.not. load%has_table()) return
    do i = 1, size(t)
      moved(i, :, 3) = matmul(load%floors, load%table%at(t(i)))
    end do
  end function floors_at

  !> Im sum_k a(:, k) exp(i w(k) t) and its derivatives, shape (size(t), size(a, 1), 3).
  pure function waves_at(w, a, t) result(moved)
    real(wp), intent(in) :: w(:), t(:)
    complex(wp), intent(in) :: a(:, :)
    real(wp) :: moved(size(t), size(a, 1), 3)
    type(base_motion_type) :: base
    base%frequencies = w
    base%amplitudes = a
    moved = base%at_times(size(a, 1), t)
  end function waves_at

  !> The load on coordinates relative to the base, a row for each time.
  function load_at(system, load, nu, t) result(force)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, t(:)
    real(wp) :: force(size(t), system%n_dof())
    type(time_load_type) :: loads
    integer :: k
    loads%frequencies = load%orders*nu
    allocate (loads%amplitudes(system%n_dof(), size(load%orders)))
    do k = 1, size(load%orders)
      loads%amplitudes(:, k) = load%coefficient(system, load%orders(k), nu)
    end do
    call load%forces_in_time(loads%breaks, loads%pieces)
    force = loads%at_times(t)
  end function load_at

end module viscovib_known_motion
