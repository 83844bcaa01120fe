! Optimize: -O1
!> A text read character by character, with error messages.
module viscovib_text_cursor
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: parse_real
  use viscovib_status, only: clipped, show
  implicit none
  private

  public :: text_cursor

  character(len=*), parameter, public :: digits = '0123456789'
  character(len=*), parameter :: white = achar(9)//achar(10)//achar(11)//achar(12)//achar(13)
  character(len=*), parameter :: names = 'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_'
  !> Typographic characters (UTF-8) used in place of ASCII: minus and dashes; middle dot, dot
  !! operator and cross; superscript 2 and 3; apostrophe, prime and closing quote.
  character(len=*), parameter :: page = char(226)//char(128)
  character(len=*), parameter :: dashes(3) = [char(226)//char(136)//char(146), &
                                              page//char(147), page//char(148)]
  character(len=*), parameter :: dots(3) = [char(194)//char(183)//' ', &
                                            char(226)//char(139)//char(133), &
                                            char(195)//char(151)//' ']
  character(len=*), parameter :: raised(2) = [char(194)//char(178), char(194)//char(179)]
  character(len=*), parameter :: primes(3) = ["'  ", page//char(178), page//char(153)]

  !> The text followed by a blank, and the current position; `fault` describes an error.
  type :: text_cursor
    character(len=:), allocatable :: text, fault
    integer :: at = 1, depth = 0
  contains
    procedure :: begin
    procedure :: peek
    procedure :: next_two
    procedure :: expect
    procedure, private :: meant
    procedure :: read_digits
  end type text_cursor

contains

  !> Start at the beginning of a text. Tabs and line ends become blanks.
  subroutine begin(self, text)
    class(text_cursor), intent(inout) :: self
    character(len=*), intent(in) :: text
    integer :: i
    self%text = text//' '
    self%fault = ''
    do i = 1, len(text)
      if (scan(text(i:i), white) > 0) self%text(i:i) = ' '
    end do
  end subroutine begin

  !> The next nonblank character.
  character function peek(self)
    class(text_cursor), intent(inout) :: self
    do while (self%at < len(self%text))
      if (self%text(self%at:self%at) /= ' ') exit
      self%at = self%at + 1
    end do
    peek = self%text(self%at:self%at)
  end function peek

  pure character(len=2) function next_two(self)
    class(text_cursor), intent(in) :: self
    next_two = self%text(self%at:min(self%at + 1, len(self%text)))
  end function next_two

  !> State what is expected in place of the present character; the first fault is kept.
  subroutine expect(self, what)
    class(text_cursor), intent(inout) :: self
    character(len=*), intent(in) :: what
    integer :: last

    if (self%fault /= '') return
    last = self%at
    ! Include all bytes of a UTF-8 character.
    do while (last < len(self%text))
      if (iand(iachar(self%text(last + 1:last + 1)), 192) /= 128) exit
      last = last + 1
    end do
    if (self%at >= len(self%text)) then
      self%fault = 'at its end: expected '//what
    else
      self%fault = quoted(self%text(self%at:last))//' (character '//show(self%at) &
                   //'): expected '//what//self%meant(self%text(self%at:last))
    end if
  end subroutine expect

  pure function quoted(sign)
    character(len=*), intent(in) :: sign
    character(len=:), allocatable :: quoted
    quoted = "'"//sign//"'"
    if (sign == "'") quoted = '"'//sign//'"'
  end function quoted

  !> Hint for common notation that laws do not support; empty if there is none.
  pure function meant(self, sign)
    class(text_cursor), intent(in) :: self
    character(len=*), intent(in) :: sign
    character(len=:), allocatable :: meant, before

    before = trim(self%text(:self%at - 1))
    before = before(max(len(before), 1):)
    meant = ''
    if (any(sign == primes)) meant = 'write the rate of x as x_dot, the rate of d as v'
    if (sign == '|') meant = 'write an absolute value as abs(x)'
    if (sign == ',' .and. scan(before, digits) > 0) meant = 'write numbers with a decimal point'
    if (any(sign == dashes)) meant = 'write minus as -'
    if (any(sign == dots)) meant = 'write products with *'
    if (any(sign == raised)) meant = 'write powers as x^2, x^3'
    if (scan(sign, names) > 0 .and. scan(before, digits//')') > 0) meant = 'write products with *'
    if (sign == '(' .and. scan(before, digits//')') > 0) meant = 'write products with *'
    if (meant /= '') meant = '; '//meant
  end function meant

  !> Read a number such as 2, .5, 1e-3.
  subroutine read_digits(self, exponents, value)
    class(text_cursor), intent(inout) :: self
    !> Letters allowed before the power of ten.
    character(len=*), intent(in) :: exponents
    real(wp), intent(out) :: value
    integer :: first, last
    logical :: ok

    first = self%at
    last = first + verify(self%text(first:), digits//'.') - 1
    if (scan(self%text(last:last), exponents) > 0) then
      last = last + 1
      if (scan(self%text(last:last), '+-') > 0) last = last + 1
      last = last + verify(self%text(last:), digits) - 1
    end if
    call parse_real(self%text(first:last - 1), value, ok)
    if (.not. ok) self%fault = "'"//clipped(self%text(first:last - 1))//"' is not a finite number"
    self%at = last
  end subroutine read_digits

end module viscovib_text_cursor
