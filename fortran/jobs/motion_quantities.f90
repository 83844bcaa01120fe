!> Accelerations and mount forces of a motion in time, and peaks of its columns.
module viscovib_motion_quantities
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_job, only: table_sink
  use viscovib_kinds, only: wp
  use viscovib_known_motion, only: know_motion, known_motion, repeat_motion
  use viscovib_located_peaks, only: is_loose, locate_peaks, peak_windows
  use viscovib_motion_accelerations, only: find_accelerations
  use viscovib_mount_forces, only: find_mount_forces, find_spring_memory, mount_forces_type
  use viscovib_mounted_body, only: springs_at_rest
  use viscovib_sorting, only: sort_reals
  use viscovib_spline_integral, only: spline_integral
  use viscovib_status, only: set_ok, status_type
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: transient_job
  use viscovib_turning_body, only: body_spring
  implicit none
  private

  public :: find_peaks, find_quantities, motion_quantities, put_forces, put_peaks

  !> Longest name of a quantity.
  integer, parameter, public :: quantity_length = 32

  type :: motion_quantities
    !> Of all coordinates, a column for each time; not allocated: not wanted.
    real(wp), allocatable :: accelerations(:, :)
    !> Not allocated: not wanted.
    type(mount_forces_type), allocatable :: forces
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

    call set_ok(status)
    if (accelerates) then
      call find_accelerations(motion, subject, nu, trajectory, quantities%accelerations, status)
      if (status%failed()) return
    end if
    if (motion%wants_forces) then
      allocate (quantities%forces)
      call find_forces(motion, subject, nu, trajectory, quantities%forces, status)
    end if
  end subroutine find_quantities

  !> Forces of the mounts of a body.
  subroutine find_forces(motion, subject, nu, trajectory, forces, status)
    class(transient_job), intent(in) :: motion
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu
    type(trajectory_type), intent(in) :: trajectory
    type(mount_forces_type), intent(out) :: forces
    type(status_type), intent(out) :: status
    type(body_spring) :: springs(size(subject%body%springs))
    type(known_motion) :: known
    real(wp) :: frequency, center(3)
    real(wp), allocatable :: memory(:, :)

    frequency = nu
    select type (motion)
    type is (hereditary_job)
      frequency = motion%nu
    end select
    call know_motion(motion, subject, subject%oscillator(), subject%load, frequency, trajectory, &
                     known, status)
    if (status%failed()) return
    center = subject%center
    if (subject%is_turning) center = center + subject%rest%q(:3)
    springs = springs_at_rest(subject%body, subject%rest)
    allocate (memory(size(trajectory%t), size(springs)), source=0.0_wp)
    if (allocated(known%ends)) then
      call find_spring_memory(springs, subject%body_kernels, subject%is_turning, known%ends, &
                              known%panel_u, known%panel_rate, known%held, trajectory%t, memory)
    end if
    call find_mount_forces(springs, subject%body%mount_of, subject%is_turning, center, known%u, &
                           known%rate, memory, forces)
  end subroutine find_forces

  !> A row a time: force, its parts, deflection, rate and moment of each mount, and the floor.
  subroutine put_forces(subject, t, forces, sink, status)
    type(subject_type), intent(in) :: subject
    real(wp), intent(in), target :: t(:)
    type(mount_forces_type), intent(in), target :: forces
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: name
    integer :: a, m

    call table%note('units: t in s, forces in N, moments in N m, deflections in m, rates in m/s, ' &
                    //'work and dissipated energy in J; without the static part')
    call table%add_reals('t', t)
    do m = 1, size(subject%body%names)
      do a = 1, 3
        name = trim(subject%body%names(m))//'.'//'xyz'(a:a)
        call table%hold_reals(name, forces%force(a, m))
        call table%add_reals(name//'_elastic', forces%elastic(:, a, m))
        call table%add_reals(name//'_damping', forces%damping(:, a, m))
        call table%add_reals(name//'_memory', forces%memory(:, a, m))
        call table%add_reals(name//'_deflection', forces%deflection(:, a, m))
        call table%add_reals(name//'_rate', forces%rate(:, a, m))
        call table%add_reals(name//'_moment', forces%moment(:, a, m))
        associate (rate => forces%rate(:, a, m))
          call table%hold_reals(name//'_work', spline_integral(t, forces%force(a, m)*rate))
          call table%hold_reals(name//'_dissipated', &
                                spline_integral(t, forces%damping(:, a, m)*rate))
        end associate
      end do
    end do
    do a = 1, 3
      call table%add_reals('floor.'//'xyz'(a:a), forces%floor(:, a))
      call table%add_reals('floor.'//'xyz'(a:a)//'_moment', forces%floor(:, a + 3))
    end do
    call sink%put('forces', table, status)
  end subroutine put_forces

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
    character(len=quantity_length), allocatable :: names(:)
    real(wp), allocatable :: breaks(:), times(:), ends(:), all_times(:), closer(:, :), some(:, :)
    integer, allocatable :: rows(:)
    integer :: i, k

    call set_ok(status)
    allocate (breaks(0), all_times(0))
    if (subject%is_structure) then
      breaks = subject%model%load%corners()
    else if (.not. subject%is_pendulum) then
      breaks = subject%load%corners()
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
    character(len=:), allocatable :: name
    integer :: a, i, m, n_columns

    m = 2 + merge(1, 0, motion%wants_accelerations)
    n_columns = m*size(wanted)
    if (allocated(quantities%forces)) n_columns = n_columns + 3*size(subject%body%names) + 3
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
    if (.not. allocated(quantities%forces)) return
    do m = 1, size(subject%body%names)
      do a = 1, 3
        call add(trim(subject%body%names(m))//'.'//'xyz'(a:a), quantities%forces%force(a, m))
      end do
    end do
    do a = 1, 3
      call add('floor.'//'xyz'(a:a), quantities%forces%floor(:, a))
    end do

  contains

    subroutine add(title, column)
      character(len=*), intent(in) :: title
      real(wp), intent(in) :: column(:)
      n_columns = n_columns + 1
      names(n_columns) = title
      values(:, n_columns) = column
    end subroutine add

  end subroutine gather

end module viscovib_motion_quantities
