!> A small test harness: a suite is a routine that runs named tests.
!!
!! A suite calls `begin('name')` before each test and any of the checks after
!! it; a failing check prints the expected and the actual value, and is counted.
!! With a test name on the command line, `begin` returns false for all other tests.
module testing
  use, intrinsic :: iso_fortran_env, only: output_unit
  use viscovib_kinds, only: wp
  use viscovib_status, only: status_type
  implicit none
  private

  public :: begin, check, check_close, check_ok, check_fails, select_test, report

  integer :: n_tests = 0, n_failed = 0
  logical :: current_failed = .false.
  character(len=:), allocatable :: current, wanted

contains

  !> Run only the test of this name; an empty name runs all tests.
  subroutine select_test(name)
    character(len=*), intent(in) :: name
    wanted = name
  end subroutine select_test

  !> Start a test; false if it is not selected.
  logical function begin(name)
    character(len=*), intent(in) :: name
    begin = .true.
    if (allocated(wanted)) begin = wanted == '' .or. wanted == name
    if (.not. begin) return
    current = name
    current_failed = .false.
    n_tests = n_tests + 1
  end function begin

  subroutine check(condition, what)
    logical, intent(in) :: condition
    character(len=*), intent(in) :: what
    if (condition) return
    if (.not. current_failed) n_failed = n_failed + 1
    current_failed = .true.
    write (output_unit, '(4a)') 'FAILED ', current, ': ', what
  end subroutine check

  !> |value - expected| <= tolerance * max(|expected|, floor).
  subroutine check_close(value, expected, tolerance, what, floor)
    real(wp), intent(in) :: value, expected, tolerance
    character(len=*), intent(in) :: what
    real(wp), intent(in), optional :: floor
    real(wp) :: scale
    character(len=120) :: numbers
    scale = abs(expected)
    if (present(floor)) scale = max(scale, floor)
    write (numbers, '(a,es24.16,a,es24.16,a,es9.2)') ': got ', value, ', expected ', expected, &
      ', tolerance ', tolerance
    call check(abs(value - expected) <= tolerance*scale, what//trim(numbers))
  end subroutine check_close

  subroutine check_ok(status)
    type(status_type), intent(in) :: status
    if (status%failed()) call check(.false., 'unexpected error: '//status%message)
  end subroutine check_ok

  !> The status must be a failure whose message contains the given text.
  subroutine check_fails(status, text)
    type(status_type), intent(in) :: status
    character(len=*), intent(in) :: text
    if (.not. status%failed()) then
      call check(.false., 'no error, expected one with "'//text//'"')
    else
      call check(index(status%message, text) > 0, &
                 'message "'//status%message//'" lacks "'//text//'"')
    end if
  end subroutine check_fails

  !> Print the count and return the number of failed tests.
  integer function report()
    write (output_unit, '(i0,a,i0,a)') n_tests - n_failed, ' passed, ', n_failed, ' failed'
    report = n_failed
  end function report

end module testing
