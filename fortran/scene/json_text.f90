!> Values in a JSON text (RFC 8259) by the names of their members: just what a file of a
!! fitted kernel needs. Places are those of the first letter of a value; 0: there is none.
module viscovib_json_text
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: parse_real
  implicit none
  private

  public :: begin_of, member, next_element, first_element, number_at, numbers_at, word_at

  character(len=*), parameter :: blanks = ' '//achar(9)//achar(10)//achar(13)
  !> Objects within objects that are followed.
  integer, parameter :: deepest = 200

contains

  !> The whole text's value.
  pure integer function begin_of(text)
    character(len=*), intent(in) :: text
    begin_of = skipped(text, 1)
  end function begin_of

  !> First place from i on that is not blank; 0 at the end.
  pure integer function skipped(text, i)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    skipped = 0
    if (i < 1 .or. i > len(text)) return
    skipped = verify(text(i:), blanks)
    if (skipped > 0) skipped = skipped + i - 1
  end function skipped

  !> Last letter of the value that begins at i; 0: it does not end.
  pure integer function end_of(text, i) result(last)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    integer :: depth, k

    last = 0
    if (i < 1 .or. i > len(text)) return
    depth = 0
    k = i
    do while (k <= len(text))
      select case (text(k:k))
      case ('"')
        k = end_of_word(text, k)
        if (k == 0) return
      case ('{', '[')
        depth = depth + 1
        if (depth > deepest) return
      case ('}', ']')
        depth = depth - 1
        if (depth < 0) then
          last = k - 1
          return
        end if
      case (',')
        if (depth == 0) then
          last = k - 1
          return
        end if
      case default
      end select
      if (depth == 0 .and. scan(text(k:k), '}]"') > 0) then
        last = k
        return
      end if
      k = k + 1
    end do
    if (depth == 0) last = len(text)
  end function end_of

  !> Closing quote of a text that opens at i.
  pure integer function end_of_word(text, i) result(last)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    last = i + 1
    do while (last <= len(text))
      if (text(last:last) == '"') return
      if (text(last:last) == '\') last = last + 1
      last = last + 1
    end do
    last = 0
  end function end_of_word

  !> Value of a member of the object that begins at `object`.
  pure integer function member(text, object, key) result(place)
    character(len=*), intent(in) :: text, key
    integer, intent(in) :: object
    integer :: i, last, name_end
    logical :: found

    place = 0
    if (object < 1) return
    if (text(object:object) /= '{') return
    i = skipped(text, object + 1)
    do while (i > 0)
      if (text(i:i) /= '"') return
      name_end = end_of_word(text, i)
      if (name_end == 0) return
      found = text(i + 1:name_end - 1) == key
      i = skipped(text, name_end + 1)
      if (i == 0) return
      if (text(i:i) /= ':') return
      i = skipped(text, i + 1)
      if (found .or. i == 0) then
        place = i
        return
      end if
      last = end_of(text, i)
      if (last == 0) return
      i = skipped(text, last + 1)
      if (i == 0) return
      if (text(i:i) /= ',') return
      i = skipped(text, i + 1)
    end do
  end function member

  !> First element of the list that begins at i.
  pure integer function first_element(text, i) result(place)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    place = 0
    if (i < 1) return
    if (text(i:i) /= '[') return
    place = skipped(text, i + 1)
    if (place > 0) then
      if (text(place:place) == ']') place = 0
    end if
  end function first_element

  !> The element after the one that begins at i.
  pure integer function next_element(text, i) result(place)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    integer :: last
    place = 0
    last = end_of(text, i)
    if (last == 0) return
    place = skipped(text, last + 1)
    if (place == 0) return
    if (text(place:place) /= ',') then
      place = 0
    else
      place = skipped(text, place + 1)
    end if
  end function next_element

  !> The word that begins at i; empty if none does.
  pure function word_at(text, i) result(word)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    character(len=:), allocatable :: word
    integer :: last
    word = ''
    if (i < 1) return
    if (text(i:i) /= '"') return
    last = end_of_word(text, i)
    if (last > 0) word = text(i + 1:last - 1)
  end function word_at

  !> The number that begins at i.
  subroutine number_at(text, i, value, ok)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    real(wp), intent(out) :: value
    logical, intent(out) :: ok
    integer :: n
    value = 0.0_wp
    ok = i >= 1 .and. i <= len(text)
    if (.not. ok) return
    n = verify(text(i:), '0123456789+-.eE') - 1
    if (n < 0) n = len(text) - i + 1
    call parse_real(text(i:i + n - 1), value, ok)
  end subroutine number_at

  !> The numbers of the list that begins at i; a single number is a list of one.
  subroutine numbers_at(text, i, values, ok)
    character(len=*), intent(in) :: text
    integer, intent(in) :: i
    real(wp), allocatable, intent(out) :: values(:)
    logical, intent(out) :: ok
    integer :: place, n, pass

    ok = i > 0
    allocate (values(1))
    if (.not. ok) return
    if (text(i:i) /= '[') then
      call number_at(text, i, values(1), ok)
      return
    end if
    do pass = 1, 2
      n = 0
      place = first_element(text, i)
      do while (place > 0)
        n = n + 1
        if (pass == 2) call number_at(text, place, values(n), ok)
        if (.not. ok) return
        place = next_element(text, place)
      end do
      if (pass == 1) then
        deallocate (values)
        allocate (values(n))
      end if
    end do
  end subroutine numbers_at

end module viscovib_json_text
