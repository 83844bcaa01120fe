!> A text assembled from many pieces. Its capacity doubles when needed, so the time is proportional
!! to the length.
module viscovib_growing_text
  implicit none
  private

  public :: growing_text

  type :: growing_text
    private
    character(len=:), allocatable :: work
    integer :: n = 0
  contains
    procedure :: add
    procedure :: text
    procedure :: length
  end type growing_text

contains

  !> Add a piece at the end.
  pure subroutine add(self, piece)
    class(growing_text), intent(inout) :: self
    character(len=*), intent(in) :: piece
    character(len=:), allocatable :: larger

    if (.not. allocated(self%work)) allocate (character(len=max(len(piece), 256)) :: self%work)
    if (self%n + len(piece) > len(self%work)) then
      allocate (character(len=2*(self%n + len(piece))) :: larger)
      larger(:self%n) = self%work(:self%n)
      call move_alloc(larger, self%work)
    end if
    self%work(self%n + 1:self%n + len(piece)) = piece
    self%n = self%n + len(piece)
  end subroutine add

  !> The text so far.
  pure function text(self)
    class(growing_text), intent(in) :: self
    character(len=:), allocatable :: text
    text = ''
    if (self%n > 0) text = self%work(:self%n)
  end function text

  pure integer function length(self)
    class(growing_text), intent(in) :: self
    length = self%n
  end function length

end module viscovib_growing_text
