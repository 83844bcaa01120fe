!> Accelerations and forces of a motion in time, and peaks of its columns.
!!
!! Accelerations of the states that a motion has kept are by the equations of motion. A motion whose
!! laws have surfaces, or with memory of exponentials, is made once more, and its equations give
!! them on the side of each surface on which the motion is. Other oscillators are looked at in all
!! their coordinates; what they remember follows from the motion at the points of its steps.
module viscovib_motion_quantities
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_job, only: table_sink
  use viscovib_kinds, only: wp
  use viscovib_known_motion, only: know_motion, known_motion, load_at, repeat_motion
  use viscovib_load, only: load_type
  use viscovib_located_peaks, only: is_loose, locate_peaks, peak_windows
  use viscovib_motion_balance, only: accelerations_of, recalled_along
  use viscovib_motion_forces, only: motion_forces, quantity_length
  use viscovib_oscillator, only: oscillator_type
  use viscovib_point_motion, only: move_point
  use viscovib_polynomial, only: polynomial_type
  use viscovib_sorting, only: sort_reals
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: transient_job
  use viscovib_whole_structure, only: may_be_whole, whole_only, whole_polynomial
  implicit none
  private

  public :: find_peaks, find_quantities, motion_quantities, put_peaks, quantity_length

  !> Names of the columns of a point.
  character(len=*), parameter, public :: of_point(9) = &
    [character(len=12) :: 'point_x', 'point_y', 'point_z', 'point_x_dot', 'point_y_dot', &
    'point_z_dot', 'point_x_ddot', 'point_y_ddot', 'point_z_ddot']

  type :: motion_quantities
    !> Of all coordinates, a column for each time; not allocated: not wanted.
    real(wp), allocatable :: accelerations(:, :)
    !> Displacements, velocities and accelerations of a point, shape (n, 9); not allocated: not
    !! wanted.
    real(wp), allocatable :: point(:, :)
    !> Not allocated: not wanted.
    type(motion_forces), allocatable :: forces
  end type motion_quantities

contains

  !> What is wanted at the times of a trajectory.
  subroutine find_quantities(motion, subject, nu, accelerates, trajectory, quantities, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load of a system without memory (rad/s).
    real(wp), intent(in) :: nu
    !> True if accelerations are wanted.
    logical, intent(in) :: accelerates
    type(trajectory_type), intent(in) :: trajectory
    type(motion_quantities), intent(out) :: quantities
    type(status_type), intent(out) :: status
    type(known_motion) :: known
    real(wp), allocatable :: accelerations(:, :)
    integer, allocatable :: rows(:)
    real(wp) :: frequency
    logical :: shown, pushed
    integer :: i

    call set_ok(status)
    frequency = nu
    select type (motion)
    type is (hereditary_job)
      frequency = motion%nu
    end select
    shown = accelerates .or. allocated(motion%point)
    ! Reactions contain the inertia of free coordinates.
    pushed = motion%wants_forces .and. allocated(subject%model%supports%names)
    if (pushed) pushed = any(abs(subject%model%supports%rows%free(:, :, 1)) > 0.0_wp)
    if (subject%is_pendulum) then
      if (shown) call of_pendulum(subject, trajectory, quantities%accelerations)
      return
    end if
    if (.not. (shown .or. motion%wants_forces)) return
    call know_motion(motion, subject, frequency, trajectory, known, status)
    if (status%failed()) return
    if (shown .or. pushed) then
      call find_accelerations(subject, frequency, known, accelerations, status)
      if (status%failed()) return
    end if
    if (shown) quantities%accelerations = accelerations
    if (allocated(motion%point)) then
      rows = [(trajectory%row_of(i), i=1, 6)]
      quantities%point = reshape(move_point(motion%point, subject%is_turning, &
                                            transpose(trajectory%states(rows, :)), &
                                            transpose(trajectory%states(rows + 1, :)), &
                                            transpose(quantities%accelerations)), &
                                 [size(trajectory%t), 9])
    end if
    if (.not. motion%wants_forces) return
    allocate (quantities%forces)
    call quantities%forces%find(subject, frequency, known)
    if (.not. allocated(subject%model%supports%names)) return
    call quantities%forces%find_reactions(subject, frequency, known, accelerations)
  end subroutine find_quantities

  !> A row a peak: its quantity, value with its sign, time and estimated error.
  subroutine put_peaks(names, which, peaks, sink, status, vary, values)
    !> Names of quantities; the index of that of each peak; peaks as of `find_peaks`.
    character(len=*), intent(in) :: names(:)
    integer, intent(in) :: which(:)
    real(wp), intent(in) :: peaks(:, :)
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    !> A number that varies, and its value for each peak.
    character(len=*), intent(in), optional :: vary
    real(wp), intent(in), optional :: values(:)
    type(table_type) :: table
    integer, target :: codes(size(which))

    codes = which - 1
    call table%note('largest magnitude of each quantity, with its sign, its time and its ' &
                    //'estimated error; units as in the tables of motion and forces')
    if (present(vary)) call table%hold_reals(vary, values)
    call table%add_words('quantity', codes, names)
    call table%hold_reals('value', peaks(1, :))
    call table%hold_reals('t', peaks(2, :))
    call table%hold_reals('error', peaks(3, :))
    call sink%put('peaks', table, status)
  end subroutine put_peaks

  !> The largest magnitude of each column of a motion, located between the states.
  subroutine find_peaks(motion, subject, nu, wanted, trajectory, quantities, names, peaks, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    !> Coordinates that tables show.
    integer, intent(in) :: wanted(:)
    type(trajectory_type), intent(in) :: trajectory
    type(motion_quantities), intent(in) :: quantities
    character(len=quantity_length), allocatable, intent(out) :: names(:)
    !> Value, time and error, shape (3, size(names)).
    real(wp), allocatable, intent(out) :: peaks(:, :)
    type(status_type), intent(out) :: status
    real(wp), allocatable :: values(:, :), peak(:), at(:), error(:)

    call gather(motion, subject, wanted, trajectory, quantities, names, values)
    allocate (peak(size(names)), at(size(names)), error(size(names)))
    call locate_closely(motion, subject, nu, wanted, trajectory, values, peak, at, error, status)
    if (status%failed()) return
    if (trajectory%error > 0.0_wp) then
      ! As much of it as the motion is off by of itself.
      error = error + trajectory%error*abs(peak)/max(maxval(abs(trajectory%states)), tiny(1.0_wp))
    end if
    peaks = transpose(reshape([peak, at, error], [size(names), 3]))
  end subroutine find_peaks

  !> Peaks of the columns of a motion; near those that its states do not locate, the motion is made
  !! once more at closer times.
  subroutine locate_closely(motion, subject, nu, wanted, trajectory, values, peak, at, error, &
                            status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    integer, intent(in) :: wanted(:)
    type(trajectory_type), intent(in) :: trajectory
    real(wp), intent(in), contiguous :: values(:, :)
    real(wp), intent(out) :: peak(:), at(:), error(:)
    type(status_type), intent(out) :: status
    type(trajectory_type) :: fine
    type(motion_quantities) :: more
    type(load_type), pointer :: load
    character(len=quantity_length), allocatable :: names(:)
    real(wp), allocatable :: breaks(:), times(:), ends(:), all_times(:), closer(:, :), some(:, :)
    integer, allocatable :: rows(:)
    integer :: i, k

    call set_ok(status)
    allocate (breaks(0), all_times(0))
    if (.not. subject%is_pendulum) then
      load => subject%whole_load()
      breaks = load%corners()
    end if
    call locate_peaks(trajectory%t, values, breaks, peak, at, error)
    if (.not. any(is_loose(peak, error))) return
    do k = 1, size(peak)
      if (.not. is_loose(peak(k), error(k))) cycle
      call peak_windows(trajectory%t, values(:, k), times, ends)
      all_times = [all_times, times]
    end do
    call sort_reals(all_times)
    all_times = [all_times(1), pack(all_times(2:), all_times(2:) > all_times(:size(all_times) - 1))]
    call repeat_motion(motion, subject, nu, trajectory, all_times, .false., fine, status)
    if (status%failed()) return
    call find_quantities(motion, subject, nu, motion%wants_accelerations, fine, more, status)
    if (status%failed()) return
    call gather(motion, subject, wanted, fine, more, names, closer)
    do k = 1, size(peak)
      if (.not. is_loose(peak(k), error(k))) cycle
      call peak_windows(trajectory%t, values(:, k), times, ends)
      rows = [(findloc(all_times >= times(i), .true., 1), i=1, size(times))]
      ends = [breaks, ends]
      call sort_reals(ends)
      some = closer(rows, k:k)
      call locate_peaks(times, some, ends, peak(k:k), at(k:k), error(k:k))
    end do
  end subroutine locate_closely

  !> Columns of a motion whose peaks are wanted, and their names.
  subroutine gather(motion, subject, wanted, trajectory, quantities, names, values)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in) :: subject
    integer, intent(in) :: wanted(:)
    type(trajectory_type), intent(in) :: trajectory
    type(motion_quantities), intent(in) :: quantities
    character(len=quantity_length), allocatable, intent(out) :: names(:)
    real(wp), allocatable, intent(out) :: values(:, :)
    character(len=quantity_length), allocatable :: of_forces(:)
    character(len=:), allocatable :: name
    real(wp), allocatable :: forces(:, :)
    integer :: i, m, n_columns

    allocate (of_forces(0), forces(size(trajectory%t), 0))
    if (allocated(quantities%forces)) then
      call quantities%forces%quantities(subject, of_forces, forces)
    end if
    n_columns = (2 + merge(1, 0, motion%wants_accelerations))*size(wanted) + size(of_forces) &
                + merge(size(of_point), 0, allocated(quantities%point))
    allocate (names(n_columns), values(size(trajectory%t), n_columns))
    n_columns = 0
    do i = 1, size(wanted)
      name = trim(subject%coordinates(wanted(i)))
      m = trajectory%row_of(wanted(i))
      call add(name, trajectory%states(m, :))
      call add(name//'_dot', trajectory%states(m + 1, :))
      if (motion%wants_accelerations) then
        call add(name//'_ddot', quantities%accelerations(wanted(i), :))
      end if
    end do
    if (allocated(quantities%point)) then
      do i = 1, size(of_point)
        call add(trim(of_point(i)), quantities%point(:, i))
      end do
    end if
    names(n_columns + 1:) = of_forces
    values(:, n_columns + 1:) = forces

  contains

    subroutine add(title, column)
      character(len=*), intent(in) :: title
      real(wp), intent(in) :: column(:)
      n_columns = n_columns + 1
      names(n_columns) = title
      values(:, n_columns) = column
    end subroutine add

  end subroutine gather

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

  !> Accelerations of the body, a column for each time: those of the equations, or by the balance
  !! of forces in all coordinates.
  subroutine find_accelerations(subject, nu, known, accelerations, status)
    type(subject_type), intent(in), target :: subject
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu
    type(known_motion), intent(in) :: known
    real(wp), allocatable, intent(out) :: accelerations(:, :)
    type(status_type), intent(out) :: status
    type(polynomial_type), target :: whole
    class(oscillator_type), pointer :: system
    type(load_type), pointer :: load
    real(wp), allocatable :: recalled(:, :), a(:, :)
    logical :: singular

    call set_ok(status)
    allocate (a(size(known%u, 1), size(known%u, 2)))
    if (allocated(known%accelerations)) then
      a = known%accelerations
    else
      load => subject%whole_load()
      if (.not. subject%is_structure) then
        system => subject%oscillator()
      else if (may_be_whole(subject%model)) then
        call whole_polynomial(subject%model, subject%structure%kernels, whole, status)
        system => whole
      else
        call fail(status, status_input_error, 'acceleration', "acceleration = 'yes': "//whole_only)
      end if
      if (status%failed()) return
      allocate (recalled(size(known%times), system%n_memory()), source=0.0_wp)
      if (allocated(known%ends)) call recalled_along(system, known%ends, known%panel_u, &
        known%panel_rate, known%held, known%times, recalled)
      call accelerations_of(system, known%u, known%rate, load_at(system, load, nu, known%times), &
                            recalled, a, singular)
    end if
    allocate (accelerations, source=transpose(a + known%moved(:, :, 3)))
  end subroutine find_accelerations

end module viscovib_motion_quantities
