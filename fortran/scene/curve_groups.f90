!> The &branch group of a scene with a mount or a polynomial system, and what groups about curves
!! share: keys that say how they are followed and where others leave.
module viscovib_curve_groups
  use viscovib_body_builder, only: body_builder, new_body_builder
  use viscovib_branch_job, only: branch_job
  use viscovib_curve_branch, only: curve_options, curve_table
  use viscovib_extra_groups, only: read_extra
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_limits, only: nearly_nothing, smooth_tolerance
  use viscovib_mount, only: mount_type
  use viscovib_mount_builder, only: change_mount, mount_numbers
  use viscovib_namelist, only: lower
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: show, status_type
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: read_curve, read_relative, read_switch, check_between, begin_body, begin_mount, &
    read_branch

  integer, parameter :: max_switches = 20

contains

  !> The options of curves, each by its name in `curve_table`.
  subroutine read_curve(reader, options, usual)
    type(group_reader), intent(inout) :: reader
    type(curve_options), intent(inout) :: options
    !> The tolerance if none is given.
    real(wp), intent(in), optional :: usual
    character(len=:), allocatable :: key
    real(wp) :: values(size(curve_table))
    integer :: i

    values = options%values()
    do i = 1, size(curve_table)
      key = trim(curve_table(i)%name)
      if (key == 'tolerance') then
        call read_relative(reader, values(i), usual)
      else if (curve_table(i)%whole) then
        values(i) = reader%read_integer(key)
      else
        values(i) = reader%read_real(key)
      end if
    end do
    if (.not. reader%status%failed()) call options%set(values)
  end subroutine read_curve

  !> `tolerance`, or its other name `rtol`.
  subroutine read_relative(reader, tolerance, usual)
    type(group_reader), intent(inout) :: reader
    real(wp), intent(out) :: tolerance
    !> The value if neither is given; that of smooth laws if missing.
    real(wp), intent(in), optional :: usual
    real(wp) :: relative

    tolerance = smooth_tolerance
    if (present(usual)) tolerance = usual
    relative = reader%read_real('rtol')
    if (relative > 0.0_wp) tolerance = relative
    tolerance = reader%read_real('tolerance', tolerance)
    if (reader%status%failed() .or. .not. abs(relative) > 0.0_wp) return
    if (abs(tolerance - relative) > 0.0_wp) then
      call reader%complain('rtol', 'rtol = '//show(relative)//': is another name of tolerance, ' &
                           //'must not be given with it')
    end if
  end subroutine read_relative

  !> Branch points to leave at, counted from 1, negative: the other way.
  subroutine read_switch(reader, switch)
    type(group_reader), intent(inout) :: reader
    integer, allocatable, intent(out) :: switch(:)

    switch = reader%read_some_integers('switch', max_switches)
    if (any(switch == 0)) call reader%complain('switch', 'switch = 0: must be the number of a ' &
                                               //'branch point, from 1, or its negative')
  end subroutine read_switch

  subroutine check_between(reader, key, value, lowest, highest)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    integer, intent(in) :: value, lowest, highest
    if (value < lowest .or. value > highest) then
      call reader%complain(key, key//' = '//show(value)//': must be '//show(lowest)//' to ' &
                           //show(highest))
    end if
  end subroutine check_between

  subroutine read_branch(reader, job, subject)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(out) :: job
    !> A mount and a body under small rotations have parameters by name.
    type(subject_type), intent(in) :: subject
    character(len=*), parameter :: names(9) = [character(len=13) :: 'nu', 'load_factor', &
                                               mount_numbers]
    character(len=:), allocatable :: word, before
    integer :: choice

    if (subject%is_body .and. subject%is_polynomial) then
      word = lower(reader%read_text('vary'))
      choice = findloc(names(:2) == word, .true., 1)
      if (choice == 0) choice = 3
      job%varies = word
    else
      word = reader%read_text('vary', allowed=names(:merge(2, 9, subject%is_polynomial .or. &
                                                           subject%is_turning)), choice=choice)
      job%varies = trim(names(choice))
    end if
    if (reader%status%failed()) return
    job%number = max(choice - 2, 0)
    before = merge('nu_', '   ', choice == 1)
    job%curve%start = reader%read_real(trim(before)//'from')
    job%curve%finish = reader%read_real(trim(before)//'to')
    job%nu = job%curve%start
    if (choice > 1) job%nu = reader%read_real('nu')
    job%options%choose_harmonics = .true.
    call reader%read_count('harmonics', job%options%harmonics, job%options%choose_harmonics)
    job%options%keep_idle = .true.
    call read_curve(reader, job%curve, subject%usual_tolerance())
    job%options%tolerance = job%curve%tolerance
    job%options%absolute = job%curve%atol
    job%stability = reader%read_yes('stability')
    call read_extra(reader, subject, job%extra)
    if (job%number > 0) then
      if (job%extra%sampling) call refuse_extra('sampling')
      if (job%extra%dissipation) call refuse_extra('dissipation')
    end if
    if (reader%status%failed()) return
    if (.not. abs(job%curve%finish - job%curve%start) > 0.0_wp) then
      word = trim(before)//'to'
      call reader%complain(word, word//' = '//show(job%curve%finish)//': must differ from ' &
                           //trim(before)//'from')
    end if

  contains

    subroutine refuse_extra(key)
      character(len=*), intent(in) :: key
      call reader%complain(key, key//' = yes: the system changes along a branch over ' &
                           //job%varies//', must be no, or vary nu or load_factor')
    end subroutine refuse_extra

  end subroutine read_branch

  !> The body at the beginning of a branch along one of its numbers, which must make one at both
  !! ends.
  subroutine begin_body(reader, job, subject)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(inout) :: job
    type(subject_type), intent(inout) :: subject
    type(body_builder) :: builder
    class(oscillator_type), allocatable :: system
    type(status_type) :: status

    if (reader%status%failed() .or. job%number == 0) return
    call new_body_builder(builder, subject%body, subject%body_kernels, subject%center, job%varies, &
                          status)
    call reader%place(status)
    if (reader%status%failed()) return
    call builder%build(job%curve%finish, system, status)
    if (status%failed()) call reader%complain('to', status%message)
    if (reader%status%failed()) return
    call builder%build(job%curve%start, system, status)
    if (status%failed()) call reader%complain('from', status%message)
    if (reader%status%failed()) return
    select type (system)
    type is (polynomial_type)
      subject%polynomial = system
    end select
    allocate (job%builder, source=builder)
  end subroutine begin_body

  !> The mount at the beginning of a branch along one of its parameters, which must make
  !! one at both ends.
  subroutine begin_mount(reader, job, mount)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(in) :: job
    type(mount_type), intent(inout) :: mount
    type(status_type) :: status

    if (reader%status%failed() .or. job%number == 0) return
    call change_mount(mount, job%number, job%curve%finish, status)
    if (status%failed()) then
      ! Nothing is left of the mount.
      call reader%complain('to', status%message)
      return
    end if
    call change_mount(mount, job%number, job%curve%start, status)
    if (status%failed()) call reader%complain('from', status%message)
    if (abs(job%curve%start) > 0.0_wp .or. reader%status%failed()) return
    ! With the terms that other values have.
    call change_mount(mount, job%number, nearly_nothing, status)
  end subroutine begin_mount

end module viscovib_curve_groups
