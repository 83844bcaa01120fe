!> Whether the whole program shall stop, which the driver sets when its time is over, or a thread,
!! which Python sets after Ctrl-C: loops that may take long look at it and end with what they have.
module viscovib_stopping
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_null_char
  implicit none
  private

  public :: stop_wanted, want_stop, set_unfinished, begin_piece, pieces_begun, is_set, &
    given_up, cut_short

  integer(c_int), bind(c, name='viscovib_stop'), volatile :: stop_flag

  !> Pieces of long work begun since the program started, which shows that it continues; about, with
  !! several threads.
  integer(c_int), volatile :: pieces = 0

  !> Whether something was left out since the program shall stop.
  logical, volatile :: cut = .false.

  interface
    integer(c_int) function c_is_set(flag) bind(c, name='viscovib_is_set')
      import :: c_int
      integer(c_int), intent(inout) :: flag
    end function c_is_set

    integer(c_int) function c_stop_wanted() bind(c, name='viscovib_stop_wanted')
      import :: c_int
    end function c_stop_wanted

    subroutine c_set_unfinished(path) bind(c, name='viscovib_set_unfinished')
      import :: c_char
      character(kind=c_char), intent(in) :: path(*)
    end subroutine c_set_unfinished
  end interface

contains

  logical function stop_wanted()
    stop_wanted = c_stop_wanted() /= 0_c_int
  end function stop_wanted

  !> Whether a flag is not 0 that another thread may set meanwhile. It is read by C, of which the
  !! compiler knows nothing, so that no loop keeps an old value; a volatile argument, which says the
  !! same, is not known to every compiler.
  logical function is_set(flag)
    integer(c_int), intent(inout) :: flag
    is_set = c_is_set(flag) /= 0_c_int
  end function is_set

  !> Whether a loop shall leave out what is left: the caller has cancelled, or the program shall
  !! stop, which is noted.
  logical function given_up(cancel)
    integer(c_int), intent(inout), optional :: cancel
    given_up = .false.
    if (present(cancel)) given_up = is_set(cancel)
    if (given_up .or. .not. stop_wanted()) return
    cut = .true.
    given_up = .true.
  end function given_up

  !> Whether a loop has left something out since the program shall stop.
  logical function cut_short()
    cut_short = cut
  end function cut_short

  !> Called by a loop before each piece that takes long: a point of a curve, a value.
  subroutine begin_piece()
    pieces = modulo(pieces, huge(pieces)) + 1
  end subroutine begin_piece

  integer(c_int) function pieces_begun()
    pieces_begun = pieces
  end function pieces_begun

  subroutine want_stop(wanted)
    logical, intent(in) :: wanted
    stop_flag = merge(1_c_int, 0_c_int, wanted)
  end subroutine want_stop

  !> The file to remove if the program ends at once; empty: none.
  subroutine set_unfinished(path)
    character(len=*), intent(in) :: path
    call c_set_unfinished(path//c_null_char)
  end subroutine set_unfinished

end module viscovib_stopping
