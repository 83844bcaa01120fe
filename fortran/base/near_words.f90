!> Words for messages about scenes: quoting, listing and search for the most similar word.
module viscovib_near_words
  implicit none
  private

  public :: closest, doubled, listed, means, off_by

  !> Number of letters of a word that are compared.
  integer, parameter, public :: longest = 32

contains

  !> Double the quotes, as inside a quoted text.
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

  !> List words separated by commas, each in quotes.
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

  !> Index of the word that another word means, or of the most similar word if it differs in at most
  !! a third of the letters; 0 if there is none.
  pure integer function closest(key, words)
    character(len=*), intent(in) :: key, words(:)
    integer :: i, best, d
    do closest = 1, size(words)
      if (means(key, trim(words(closest)))) return
    end do
    closest = 0
    best = max(min(len(key), longest)/3, 1) + 1
    do i = 1, size(words)
      d = off_by(key, trim(words(i)))
      if (d < best) then
        best = d
        closest = i
      end if
    end do
  end function closest

  !> True if a word is the beginning of another word (three letters or more), or a synonym.
  pure logical function means(given, word)
    character(len=*), intent(in) :: given, word
    select case (given)
    case ('freq', 'frequency', 'omega')
      means = word == 'nu'
    case ('sgn')
      means = word == 'sign'
    case ('ln')
      means = word == 'log'
    case default
      means = len(given) >= 3 .and. len(given) < len(word) .and. index(word, given) == 1
    end select
  end function means

  !> Distance between a name and a name that may be meant. A name of one letter is a symbol, which
  !! is only similar to the same letter in the other case.
  pure integer function off_by(given, name)
    character(len=*), intent(in) :: given, name
    off_by = shiftr(huge(1), 2)
    if (len(given) /= 1) then
      off_by = distance(given, name)
    else if (len(name) == 1) then
      if (ior(iachar(given), 32) == ior(iachar(name), 32)) off_by = 1
    end if
  end function off_by

  !> Number of letters to change, add, remove or swap with the next one. Only the first letters of
  !! long words are compared.
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
