!> Words as messages about scenes need them: quoted, listed, and which of them one is nearest to.
module viscovib_near_words
  implicit none
  private

  public :: closest, distance, doubled, listed

  !> Letters of a word that count.
  integer, parameter, public :: longest = 32

contains

  !> Quotes doubled, as inside a quoted text.
  pure function doubled(text)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: doubled
    integer :: i, n
    allocate (character(len=len(text) + count([(text(i:i) == "'", i=1, len(text))])) :: doubled)
    n = 0
    do i = 1, len(text)
      n = n + 1
      doubled(n:n) = text(i:i)
      if (text(i:i) /= "'") cycle
      n = n + 1
      doubled(n:n) = "'"
    end do
  end function doubled

  !> Words with commas between, each in such quotes.
  pure function listed(words, quote)
    character(len=*), intent(in) :: words(:), quote
    character(len=:), allocatable :: listed
    integer :: i
    listed = ''
    do i = 1, size(words)
      if (i > 1) listed = listed//', '
      listed = listed//quote//trim(words(i))//quote
    end do
  end function listed

  !> The word that differs least, if by at most a third of its letters.
  pure integer function closest(key, words)
    character(len=*), intent(in) :: key, words(:)
    integer :: i, best, d
    closest = 0
    best = max(min(len(key), longest)/3, 1) + 1
    do i = 1, size(words)
      d = distance(key, trim(words(i)))
      if (d < best) then
        best = d
        closest = i
      end if
    end do
  end function closest

  !> Letters to change, add, drop or exchange with the next one; what is longer
  !! than any key counts with its first letters only.
  pure integer function distance(a, b)
    character(len=*), intent(in) :: a, b
    integer :: d(-1:min(len(a), 2*longest), -1:len(b)), i, j
    d = 0
    d(0:, 0) = [(i, i=0, ubound(d, 1))]
    d(0, 0:) = [(j, j=0, ubound(d, 2))]
    do j = 1, ubound(d, 2)
      do i = 1, ubound(d, 1)
        d(i, j) = min(d(i - 1, j) + 1, d(i, j - 1) + 1, &
                      d(i - 1, j - 1) + merge(0, 1, a(i:i) == b(j:j)))
        if (i == 1 .or. j == 1) cycle
        if (a(i:i) == b(j - 1:j - 1) .and. a(i - 1:i - 1) == b(j:j)) then
          d(i, j) = min(d(i, j), d(i - 2, j - 2) + 1)
        end if
      end do
    end do
    distance = d(ubound(d, 1), ubound(d, 2))
  end function distance

end module viscovib_near_words
