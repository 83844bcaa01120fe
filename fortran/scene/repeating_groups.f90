!> The &steady_motion and &trace_motion groups of a scene.
module viscovib_repeating_groups
  use viscovib_checks, only: check_positive
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_limits, only: max_time_tolerance, min_time_tolerance
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_motion_branch, only: longest_max_step, most_points, shortest_max_step
  use viscovib_shooting, only: accuracy_type, most_periods
  use viscovib_status, only: show, status_type
  use viscovib_steady_motion_job, only: check_repeats, steady_motion_job
  use viscovib_subject, only: subject_type
  use viscovib_trace_motion_job, only: trace_motion_job
  implicit none
  private

  public :: read_steady_motion, read_trace_motion

  !> The relative error if no other is given.
  real(wp), parameter :: usual_error = 1.0e-10_wp
  !> Methods with derivatives: the first ones of the catalogue.
  integer, parameter :: n_methods = 2

contains

  subroutine read_steady_motion(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(steady_motion_job), intent(out) :: job
    type(status_type) :: status

    call check_repeats(subject, job%kind(), status)
    if (status%failed()) then
      call reader%complain(job%kind(), status%message)
      return
    end if
    job%nu = reader%read_real('nu')
    if (reader%status%failed()) return
    call check_positive('nu', job%nu, status)
    call reader%place(status)
    call read_search(reader, subject, job%n_periods, job%method, job%accuracy, job%initial)
  end subroutine read_steady_motion

  subroutine read_trace_motion(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(trace_motion_job), intent(out) :: job
    character(len=*), parameter :: names(2) = [character(len=11) :: 'nu', 'load_factor']
    type(status_type) :: status
    character(len=:), allocatable :: before, word
    integer :: choice

    call check_repeats(subject, job%kind(), status)
    if (status%failed()) then
      call reader%complain(job%kind(), status%message)
      return
    end if
    word = reader%read_text('vary', 'nu', names, choice)
    if (reader%status%failed()) return
    job%is_frequency = choice == 1
    before = trim(merge('nu_', '   ', job%is_frequency))
    job%options%start = reader%read_real(before//'from')
    job%options%finish = reader%read_real(before//'to')
    job%nu = job%options%start
    if (.not. job%is_frequency) job%nu = reader%read_real('nu')
    if (reader%status%failed()) return
    word = trim(merge('nu_from', 'nu     ', job%is_frequency))
    call check_positive(word, job%nu, status)
    call reader%place(status)
    if (job%is_frequency) then
      call check_positive('nu_to', job%options%finish, status)
      call reader%place(status)
    end if
    if (.not. abs(job%options%finish - job%options%start) > 0.0_wp) then
      call reader%complain(before//'to', before//'to = '//show(job%options%finish) &
                           //': must differ from '//before//'from')
    end if
    call read_search(reader, subject, job%n_periods, job%method, job%options%accuracy, &
                     job%options%begin)
    job%options%max_step = reader%read_real('max_step', job%options%max_step)
    job%options%max_points = reader%read_integer('max_points', job%options%max_points)
    if (reader%status%failed()) return
    associate (step => job%options%max_step, points => job%options%max_points)
      if (.not. (step >= shortest_max_step .and. step <= longest_max_step)) then
        call reader%complain('max_step', 'max_step = '//show(step)//': must be ' &
                             //show(shortest_max_step)//' to '//show(longest_max_step))
      else if (points < 2 .or. points > most_points) then
        call reader%complain('max_points', 'max_points = '//show(points)//': must be 2 to ' &
                             //show(most_points))
      end if
    end associate
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
    n_periods = reader%read_integer('n_periods', 1)
    if (.not. reader%status%failed() .and. (n_periods < 1 .or. n_periods > most_periods)) then
      call reader%complain('n_periods', 'n_periods = '//show(n_periods)//': must be 1 to ' &
                           //show(most_periods))
    end if
    word = reader%read_text('method', trim(transient_methods(1)), transient_methods(:n_methods), &
                            method)
    call read_accuracy(reader, accuracy)
    if (reader%status%failed()) return
    if (reader%has('initial')) initial = reader%read_reals('initial', 2*size(subject%coordinates))
  end subroutine read_search

  !> `tolerance`, or in its place `rtol` and `atol`.
  subroutine read_accuracy(reader, accuracy)
    type(group_reader), intent(inout) :: reader
    type(accuracy_type), intent(out) :: accuracy

    if (reader%has('tolerance')) then
      accuracy%absolute = reader%read_real('tolerance')
      if (reader%has('rtol') .or. reader%has('atol')) then
        call reader%complain('tolerance', 'tolerance = '//show(accuracy%absolute)//': is atol ' &
                             //'alone, must not be given with rtol or atol')
      end if
      call check('tolerance', accuracy%absolute)
      return
    end if
    if (reader%has('rtol') .or. .not. reader%has('atol')) then
      accuracy%relative = reader%read_real('rtol', usual_error)
      call check('rtol', accuracy%relative)
    end if
    if (.not. reader%has('atol')) return
    accuracy%absolute = reader%read_real('atol')
    if (accuracy%absolute > 0.0_wp .or. (reader%has('rtol') &
                                         .and. .not. accuracy%absolute < 0.0_wp)) return
    call reader%complain('atol', 'atol = '//show(accuracy%absolute)//': must be greater than 0, ' &
                         //'or 0 with an rtol')

  contains

    subroutine check(key, value)
      character(len=*), intent(in) :: key
      real(wp), intent(in) :: value
      if (value >= min_time_tolerance .and. value <= max_time_tolerance) return
      call reader%complain(key, key//' = '//show(value)//': must be '//show(min_time_tolerance) &
                           //' to '//show(max_time_tolerance))
    end subroutine check

  end subroutine read_accuracy

end module viscovib_repeating_groups
