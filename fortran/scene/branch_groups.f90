!> The &branch group of a scene with a mount or a polynomial system.
module viscovib_branch_groups
  use viscovib_branch_job, only: branch_job
  use viscovib_checks, only: check_positive
  use viscovib_curve_groups, only: read_curve, read_yes
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_limits, only: nearly_nothing
  use viscovib_mount, only: mount_type
  use viscovib_mount_builder, only: change_mount, mount_numbers
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: read_branch, begin_mount

contains

  subroutine read_branch(reader, job, is_mount)
    type(group_reader), intent(inout) :: reader
    type(branch_job), intent(out) :: job
    !> Else of a system, which has no parameters by name.
    logical, intent(in) :: is_mount
    character(len=*), parameter :: names(9) = [character(len=13) :: 'nu', 'load_factor', &
                                               mount_numbers]
    type(status_type) :: status
    character(len=:), allocatable :: word, before
    integer :: choice

    word = reader%read_text('vary', 'nu', names(:merge(9, 2, is_mount)), choice)
    if (reader%status%failed()) return
    job%varies = trim(names(choice))
    job%number = max(choice - 2, 0)
    before = merge('nu_', '   ', choice == 1)
    job%curve%start = reader%read_real(trim(before)//'from')
    job%curve%finish = reader%read_real(trim(before)//'to')
    job%nu = job%curve%start
    if (choice > 1) job%nu = reader%read_real('nu')
    job%options%choose_harmonics = .true.
    call reader%read_count('harmonics', job%options%harmonics, 'auto', &
                           job%options%choose_harmonics)
    job%options%keep_idle = .true.
    call read_curve(reader, job%curve)
    job%options%tolerance = job%curve%tolerance
    job%options%absolute = job%curve%atol
    job%stability = read_yes(reader, 'stability')
    if (reader%status%failed()) return
    if (choice > 1) then
      call check_positive('nu', job%nu, status)
      call reader%place(status)
    else
      call check_positive('nu_from', job%curve%start, status)
      call reader%place(status)
      call check_positive('nu_to', job%curve%finish, status)
      call reader%place(status)
    end if
    if (.not. abs(job%curve%finish - job%curve%start) > 0.0_wp) then
      word = trim(before)//'to'
      call reader%complain(word, word//' = '//show(job%curve%finish)//': must differ from ' &
                           //trim(before)//'from')
    end if
  end subroutine read_branch

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

end module viscovib_branch_groups
