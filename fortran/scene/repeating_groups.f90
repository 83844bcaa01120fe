!> The &steady_motion and &trace_motion groups of a scene.
module viscovib_repeating_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_shooting, only: accuracy_type
  use viscovib_status, only: show, status_type
  use viscovib_steady_motion_job, only: check_repeats, steady_motion_job
  use viscovib_subject, only: subject_type
  use viscovib_trace_motion_job, only: trace_motion_job
  implicit none
  private

  public :: read_accuracy, read_steady_motion, read_trace_motion

contains

  subroutine read_steady_motion(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(steady_motion_job), intent(out) :: job
    type(status_type) :: status

    call check_repeats(subject, reader%group%name, status)
    if (status%failed()) then
      call reader%complain(reader%group%name, status%message)
      return
    end if
    job%nu = reader%read_real('nu')
    call read_search(reader, subject, job%n_periods, job%method, job%accuracy, job%initial)
  end subroutine read_steady_motion

  subroutine read_trace_motion(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(trace_motion_job), intent(out) :: job
    type(status_type) :: status
    character(len=:), allocatable :: before

    call check_repeats(subject, reader%group%name, status)
    if (status%failed()) then
      call reader%complain(reader%group%name, status%message)
      return
    end if
    job%is_frequency = reader%read_text('vary') == 'nu'
    if (reader%status%failed()) return
    before = trim(merge('nu_', '   ', job%is_frequency))
    job%options%start = reader%read_real(before//'from')
    job%options%finish = reader%read_real(before//'to')
    job%nu = job%options%start
    if (.not. job%is_frequency) job%nu = reader%read_real('nu')
    if (.not. abs(job%options%finish - job%options%start) > 0.0_wp) then
      call reader%complain(before//'to', before//'to = '//show(job%options%finish) &
                           //': must differ from '//before//'from')
    end if
    call read_search(reader, subject, job%n_periods, job%method, job%options%accuracy, &
                     job%options%begin)
    job%options%max_step = reader%read_real('max_step')
    job%options%max_points = reader%read_integer('max_points')
  end subroutine read_trace_motion

  !> How a motion is found: `n_periods`, `method`, `initial`, and how accurate it is.
  subroutine read_search(reader, subject, n_periods, method, accuracy, initial)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    integer, intent(out) :: n_periods, method
    type(accuracy_type), intent(out) :: accuracy
    !> Not allocated if it is not given.
    real(wp), allocatable, intent(out) :: initial(:)
    character(len=:), allocatable :: word

    n_periods = 1
    method = 1
    if (reader%status%failed()) return
    n_periods = reader%read_integer('n_periods')
    word = reader%read_text('method', choice=method)
    call read_accuracy(reader, accuracy)
    if (reader%status%failed()) return
    if (reader%may_have('initial')) then
      initial = reader%read_reals('initial', 2*size(subject%coordinates))
    end if
  end subroutine read_search

  !> `tolerance`, or in its place `rtol` and `atol`.
  subroutine read_accuracy(reader, accuracy)
    type(group_reader), intent(inout) :: reader
    type(accuracy_type), intent(out) :: accuracy

    if (reader%may_have('tolerance')) then
      accuracy%absolute = reader%read_real('tolerance')
      if (reader%has('rtol') .or. reader%has('atol')) then
        call reader%complain('tolerance', 'tolerance = '//show(accuracy%absolute)//': is atol ' &
                             //'alone, must not be given with rtol or atol')
      end if
      return
    end if
    if (reader%has('rtol') .or. .not. reader%has('atol')) then
      accuracy%relative = reader%read_real('rtol')
    end if
    if (.not. reader%may_have('atol')) return
    accuracy%absolute = reader%read_real('atol')
    if (accuracy%absolute > 0.0_wp .or. (reader%has('rtol') &
                                         .and. .not. accuracy%absolute < 0.0_wp)) return
    call reader%complain('atol', 'atol = '//show(accuracy%absolute)//': must be greater than 0, ' &
                         //'or 0 with an rtol')
  end subroutine read_accuracy

end module viscovib_repeating_groups
