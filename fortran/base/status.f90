! Optimize: -O2
!> Reports errors to the caller.
!!
!! No routine below `app/` stops or prints. A routine that can fail has a `type(status_type),
!! intent(out)` argument. An *outcome* of a computation (converged, diverged, ...) is not an error;
!! it is part of the result.
module viscovib_status
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: status_type, set_ok, fail, show, things, clipped, one_line

  !> Categories of failure; the driver's exit codes follow them.
  integer, parameter, public :: status_ok = 0
  integer, parameter, public :: status_input_error = 2
  integer, parameter, public :: status_io_error = 3


  type :: status_type
    !> One of the `status_*` categories.
    integer :: category = status_ok
    !> One line with the name, its value and what is allowed.
    character(len=:), allocatable :: message
    !> Name of the invalid argument or key, for callers that report its location.
    character(len=:), allocatable :: subject
  contains
    procedure :: failed
  end type status_type

  !> Format a number for a message.
  interface show
    module procedure show_real, show_integer
  end interface show

contains

  elemental logical function failed(self)
    class(status_type), intent(in) :: self
    failed = self%category /= status_ok
  end function failed

  subroutine set_ok(status)
    type(status_type), intent(out) :: status
    status%category = status_ok
  end subroutine set_ok

  !> Set a failure.
  subroutine fail(status, category, subject, message)
    type(status_type), intent(out) :: status
    integer, intent(in) :: category
    character(len=*), intent(in) :: subject, message
    status%category = category
    status%subject = subject
    status%message = message
  end subroutine fail

  !> A message for display: characters that would end the line (such as a new line in a file name)
  !! or control a terminal become question marks.
  pure function one_line(text) result(shown)
    character(len=*), intent(in) :: text
    character(len=len(text)) :: shown
    integer :: i
    shown = text
    do i = 1, len(text)
      if (iachar(text(i:i)) < 32 .or. iachar(text(i:i)) == 127) shown(i:i) = '?'
    end do
  end function one_line

  !> User text for a message, clipped to fit a line.
  pure function clipped(text) result(shown)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: shown
    integer, parameter :: longest = 60
    integer :: n
    if (len(text) <= longest) then
      shown = text
      return
    end if
    ! Not within a multibyte UTF-8 character.
    n = longest - 3
    do while (n > longest - 7 .and. iand(iachar(text(n + 1:n + 1)), 192) == 128)
      n = n - 1
    end do
    shown = text(:n)//'...'
  end function clipped

  pure function show_integer(value) result(text)
    integer, intent(in) :: value
    character(len=:), allocatable :: text
    character(len=16) :: buffer
    write (buffer, '(i0)') value
    text = trim(buffer)
  end function show_integer

  !> Shortest of a few formats that reproduces the value: fixed point between 1e-4 and 1e7,
  !! otherwise with an exponent.
  pure function show_real(value) result(text)
    real(wp), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=40) :: buffer
    character(len=16) :: form
    real(wp) :: back
    integer :: digits, e, last, tail, decade

    if (value /= value) then
      text = 'nan'
      return
    else if (abs(value) > huge(value)) then
      text = trim(merge('-inf', 'inf ', value < 0.0_wp))
      return
    end if
    if (abs(value) <= 0.0_wp) then
      text = '0'
      return
    end if
    if (abs(value) >= nearest(huge(value), -1.0_wp)) then
      ! Rounding to fewer digits would give infinity.
      text = trim(merge('-1.7976931348623157e308', '1.7976931348623157e308 ', value < 0.0_wp))
      return
    end if
    decade = floor(log10(abs(value)))
    do digits = 6, 17
      if (decade >= -4 .and. decade < 7) then
        write (form, '(a,i0,a)') '(f0.', max(digits - 1 - decade, 1), ')'
      else
        write (form, '(a,i0,a)') '(es0.', digits - 1, 'e3)'
      end if
      write (buffer, form) value
      read (buffer, *) back
      if (abs(back - value) <= 0.0_wp) exit
    end do
    e = scan(buffer, 'E')
    tail = len_trim(buffer)
    if (e > 0) tail = e - 1
    last = verify(buffer(:tail), '0', back=.true.)
    if (buffer(last:last) == '.') last = last - 1
    text = buffer(:last)
    if (e > 0) text = text//'e'//show_integer(decade)
    if (text(1:1) == '.') text = '0'//text
    if (len(text) > 1) then
      if (text(1:2) == '-.') text = '-0'//text(2:)
    end if
  end function show_real

  !> A count with its noun: 1 fold, 2 folds.
  pure function things(n, name, many) result(text)
    integer, intent(in) :: n
    character(len=*), intent(in) :: name
    !> Irregular plural.
    character(len=*), intent(in), optional :: many
    character(len=:), allocatable :: text
    text = show(n)//' '//name
    if (n == 1) return
    if (present(many)) then
      text = show(n)//' '//many
    else
      text = text//'s'
    end if
  end function things

end module viscovib_status
