! Optimize: -O1
!> Stop requests, for the whole program (set by the driver at its time limit) or for a thread (set
!! by Python after Ctrl-C). Long loops check them and return partial results.
module viscovib_stopping
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_null_char
  implicit none
  private

  public :: stop_wanted, want_stop, set_unfinished, begin_piece, pieces_begun, is_set, &
    given_up, cut_short

  integer(c_int), bind(c, name='viscovib_stop'), volatile :: stop_flag

  !> Number of pieces of long work started so far, which shows progress; approximate with several
  !! threads.
  integer(c_int), volatile :: pieces = 0

  !> True if work was omitted because of a stop request.
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

  !> True if a flag that another thread may set is present and not 0. It is read by a C function, so
  !! that the compiler cannot keep an old value in a loop; not every compiler supports a volatile
  !! argument.
  logical function is_set(flag)
    integer(c_int), intent(inout), optional :: flag
    is_set = .false.
    if (present(flag)) is_set = c_is_set(flag) /= 0_c_int
  end function is_set

  !> True if a loop must skip its remaining work: the caller has cancelled it, or the program must
  !! stop, which is recorded.
  logical function given_up(cancel)
    integer(c_int), intent(inout), optional :: cancel
    given_up = is_set(cancel)
    if (given_up .or. .not. stop_wanted()) return
    cut = .true.
    given_up = .true.
  end function given_up

  !> True if a loop has skipped work since the stop request.
  logical function cut_short()
    cut_short = cut
  end function cut_short

  !> Call before each long piece of work in a loop: a point of a curve, a value.
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

  !> Set the file to remove if the program is terminated; empty: none.
  subroutine set_unfinished(path)
    character(len=*), intent(in) :: path
    call c_set_unfinished(path//c_null_char)
  end subroutine set_unfinished

end module viscovib_stopping
