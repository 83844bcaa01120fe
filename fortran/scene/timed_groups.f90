!> Loads of a scene that are not periodic: shocks by formula, and records.
module viscovib_timed_groups
  use viscovib_checks, only: check_increasing
  use viscovib_constants, only: standard_gravity
  use viscovib_group_reader, only: group_reader
  use viscovib_kernel_table, only: read_pairs
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_record_doubts, only: doubt_record
  use viscovib_shock_shapes, only: new_shock, shock_names, shock_type
  use viscovib_status, only: show, status_type
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: read_in_time, read_record

  !> Place of "record" among the shapes: after "sine" and those of `shock_names`.
  integer, parameter :: record = size(shock_names) + 2

contains

  !> A shock or a record as a row of loads: a force along a direction, or an acceleration of the
  !! base, which moves the coordinates along it.
  subroutine read_in_time(reader, subject, kind, repeats, direction, load)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(inout) :: subject
    character(len=*), intent(in) :: kind
    !> Whether the scene wants motions under loads that repeat.
    logical, intent(in) :: repeats
    !> Shape (n_dof).
    real(wp), intent(in) :: direction(:)
    type(load_type), intent(inout) :: load
    real(wp), allocatable :: times(:), pieces(:, :), push(:)
    character(len=:), allocatable :: word, doubts
    real(wp) :: amplitude, factor
    integer :: shape

    word = reader%read_text('shape', 'sine', choice=shape)
    if (shape == 1) then
      call reader%complain('shape', "shape: kind = 'acceleration' needs a shock, such as " &
                           //"shape = 'half_sine', or shape = 'record'")
    else if (word == 'run_up' .and. kind /= 'unbalance') then
      call reader%complain('kind', "kind = '"//kind//"': must be 'unbalance' with shape = 'run_up'")
    else if (word /= 'run_up' .and. all(kind /= ['force       ', 'acceleration'])) then
      call reader%complain('kind', "kind = '"//kind//"': must be 'force' or 'acceleration' with " &
                           //"shape = '"//word//"'")
    else if (repeats) then
      call reader%complain('shape', "shape = '"//word//"': is a load of &transient only")
    end if
    call reader%refuse(pack(['order', 'phase'], [.true., word /= 'run_up']), &
                       "must be left out with shape = '"//word//"'")
    if (reader%status%failed()) return
    factor = 1.0_wp
    if (kind == 'acceleration') then
      call read_unit(reader, word, factor)
    else
      word = 'm/s^2'
      call reader%refuse(['unit'], "is the unit of kind = 'acceleration'")
    end if
    if (shape == record) then
      call read_pieces(reader, times, pieces)
    else
      call read_shock(reader, shape - 1, times, pieces)
    end if
    if (shape == record .or. reader%has('force') .or. reader%has('torque')) then
      amplitude = reader%read_real('amplitude', 1.0_wp)
    else
      amplitude = reader%read_real('amplitude')
    end if
    if (reader%status%failed()) return
    pieces = factor*(amplitude*pieces)
    if (kind /= 'acceleration') then
      call load%add_row(times, pieces, direction, 0.0_wp*direction)
      return
    end if
    if (subject%model%supports%are_pulled()) then
      call reader%complain('kind', "kind = 'acceleration': deforms springs or dampers at the " &
                           //"supports, must be kind = 'base'")
      return
    end if
    push = -inertia(subject, direction)
    if (.not. any(abs(push) > 0.0_wp)) then
      call reader%complain('kind', 'base_acceleration: no mass moves in this direction of the base')
      return
    end if
    call doubt_record('base_acceleration', pieces(size(pieces, 1), :), word, shape == record, &
                      doubts)
    subject%warned = subject%warned//doubts
    call load%add_row(times, pieces, push, direction)
  end subroutine read_in_time

  !> The unit of an acceleration, and its size in m/s^2.
  subroutine read_unit(reader, unit, factor)
    type(group_reader), intent(inout) :: reader
    character(len=:), allocatable, intent(out) :: unit
    real(wp), intent(out) :: factor
    unit = reader%read_text('unit')
    factor = merge(standard_gravity, 1.0_wp, unit == 'g')
  end subroutine read_unit

  !> A shock of height 1.
  subroutine read_shock(reader, shape, times, pieces)
    type(group_reader), intent(inout) :: reader
    !> Place in `shock_names`.
    integer, intent(in) :: shape
    real(wp), allocatable, intent(out) :: times(:), pieces(:, :)
    type(shock_type) :: shock
    type(status_type) :: status

    shock%shape = shape
    shock%start = reader%read_real('start')
    if (shock_names(shape) /= 'step') shock%duration = reader%read_real('duration')
    if (shock_names(shape) == 'trapezoid') then
      shock%rise = reader%read_real('rise', 0.1_wp*shock%duration)
      shock%fall = reader%read_real('fall', shock%rise)
    else if (shock_names(shape) == 'chirp') then
      shock%hz = reader%read_reals('hz')
      shock%is_logarithmic = reader%read_text('sweep') == 'logarithmic'
    else if (shock_names(shape) == 'run_up') then
      shock%speed = reader%read_reals('speed')
      shock%hold = reader%read_real('hold')
      shock%phase = reader%read_real('phase')
    end if
    if (reader%status%failed()) return
    call new_shock(shock, times, pieces, status)
    call reader%place(status)
  end subroutine read_shock

  !> A record as straight lines between its times.
  subroutine read_pieces(reader, times, pieces)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: times(:), pieces(:, :)
    real(wp), allocatable :: values(:)
    integer :: n

    call read_record(reader, times, values)
    n = size(times)
    allocate (pieces(4, n), source=0.0_wp)
    if (reader%status%failed()) return
    pieces(3, :n - 1) = (values(2:) - values(:n - 1))/(times(2:) - times(:n - 1))
    pieces(4, :) = values
  end subroutine read_pieces

  !> Times, ascending, and values of a record, here or in a file of two columns.
  subroutine read_record(reader, times, values)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: times(:), values(:)
    type(status_type) :: status
    character(len=:), allocatable :: path

    call read_pairs(reader, times, values)
    if (reader%status%failed()) return
    path = merge('file ', 'times', reader%has('file'))
    if (size(times) < 2) then
      call reader%complain(trim(path), trim(path)//': must have at least 2 times, has ' &
                           //show(size(times)))
    else
      call check_increasing('times', times, status)
      if (status%failed()) call reader%complain(trim(path), status%message)
    end if
  end subroutine read_record

  !> M b, for the direction b in which the base moves.
  function inertia(subject, direction)
    type(subject_type), intent(in) :: subject
    real(wp), intent(in) :: direction(:)
    real(wp) :: inertia(size(direction))
    if (subject%is_structure) then
      inertia = matmul(subject%model%mass, direction)
      if (allocated(subject%model%supports%mass)) then
        if (all(abs(direction - subject%model%base_direction) <= 0.0_wp)) then
          inertia = inertia + subject%model%supports%mass
        end if
      end if
    else if (subject%is_turning) then
      inertia = matmul(subject%turning%mass, direction)
    else if (subject%is_polynomial) then
      inertia = matmul(subject%polynomial%mass, direction)
    else
      inertia = matmul(subject%mount%mass, direction)
    end if
  end function inertia

end module viscovib_timed_groups
