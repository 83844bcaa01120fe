! Optimize: -O2
!> Ends of the steps of a run: equal steps between the times at which a load has a
!! jump or a corner, so that the load is smooth in every step, and the step keeps its order.
module viscovib_mesh
  use viscovib_kinds, only: i8, wp
  implicit none
  private

  public :: mesh_type, new_mesh, equal_steps, extend_ends, first_after

  !> Two times closer than this number of floating-point spacings are equal.
  real(wp), parameter :: same = 8.0_wp

  type :: mesh_type
    !> Ends of the pieces, the first begins at 0; number of steps at the end of each, ascending.
    real(wp), allocatable :: ends(:)
    integer(i8), allocatable :: made_by(:)
    !> Length of the steps of each piece.
    real(wp), allocatable :: h(:)
  contains
    procedure :: piece_of
    procedure :: begins
    procedure :: time
    procedure :: made_until
    procedure :: start_of
    procedure :: beginning
    procedure :: is_broken
  end type mesh_type

contains

  !> Pieces with their ends and numbers of steps at each end; without ends above 0: equal steps h.
  pure subroutine new_mesh(mesh, h, ends, made_by)
    type(mesh_type), intent(out) :: mesh
    real(wp), intent(in) :: h
    !> Shape (n), ascending.
    real(wp), intent(in) :: ends(:)
    integer(i8), intent(in) :: made_by(:)
    integer :: i

    if (.not. any(ends > 0.0_wp)) then
      mesh = equal_steps(h)
      return
    end if
    allocate (mesh%ends, source=ends)
    allocate (mesh%made_by, source=made_by)
    allocate (mesh%h, source=ends/real(made_by(1), wp))
    do i = 2, size(ends)
      mesh%h(i) = (ends(i) - ends(i - 1))/real(made_by(i) - made_by(i - 1), wp)
    end do
    ! Steps that differ by rounding only are the same.
    do i = 2, size(ends)
      if (abs(mesh%h(i) - mesh%h(i - 1)) <= 4.0_wp*spacing(mesh%h(i))) mesh%h(i) = mesh%h(i - 1)
    end do
  end subroutine new_mesh

  !> Extend ends of pieces, and the numbers of steps at them, to a later end, with steps of at most
  !! h, and a piece between any two of the ascending `breaks`.
  pure subroutine extend_ends(ends, made_by, h, breaks, end)
    real(wp), allocatable, intent(inout) :: ends(:)
    integer(i8), allocatable, intent(inout) :: made_by(:)
    real(wp), intent(in) :: h, breaks(:), end
    integer(i8), allocatable :: counts(:)
    real(wp), allocatable :: all_ends(:)
    real(wp) :: begin, before, near
    integer :: i, n

    n = size(ends)
    allocate (counts(n + size(breaks) + 1), all_ends(n + size(breaks) + 1))
    begin = 0.0_wp
    if (n > 0) begin = ends(n)
    near = same*spacing(max(abs(end), abs(begin)))
    all_ends(:n) = ends
    counts(:n) = made_by
    before = -huge(1.0_wp)
    do i = 1, size(breaks) + 1
      if (i > size(breaks)) then
        n = n + 1
        all_ends(n) = end
      else
        if (breaks(i) <= begin + near .or. breaks(i) >= end - near) cycle
        if (breaks(i) - before > near) then
          n = n + 1
          all_ends(n) = breaks(i)
        end if
        before = breaks(i)
      end if
    end do
    do i = size(ends) + 1, n
      if (i > 1) begin = all_ends(i - 1)
      counts(i) = max(ceiling((all_ends(i) - begin)/h*(1.0_wp - 1.0e-12_wp), i8), 1_i8)
      if (i > 1) counts(i) = counts(i) + counts(i - 1)
    end do
    ends = all_ends(:n)
    made_by = counts(:n)
  end subroutine extend_ends

  !> The shortest time between breaks after an end; infinite without breaks.
  pure real(wp) function first_after(breaks, end) result(shortest)
    real(wp), intent(in) :: breaks(:), end
    real(wp) :: before
    integer :: i
    shortest = huge(1.0_wp)
    before = end
    do i = 1, size(breaks)
      if (breaks(i) < end) cycle
      if (breaks(i) - before > same*spacing(end)) shortest = min(shortest, breaks(i) - before)
      before = breaks(i)
    end do
  end function first_after

  !> A mesh of equal steps without end.
  pure type(mesh_type) function equal_steps(h)
    real(wp), intent(in) :: h
    ! Allocated, since gfortran 12 reports assignments to them as uses.
    allocate (equal_steps%ends(1), source=huge(1.0_wp))
    allocate (equal_steps%made_by(1), source=huge(1_i8))
    allocate (equal_steps%h(1), source=h)
  end function equal_steps

  !> True if there are pieces with an end.
  pure logical function is_broken(self)
    class(mesh_type), intent(in) :: self
    is_broken = self%ends(1) < huge(1.0_wp)
  end function is_broken

  !> The piece that contains step k+1.
  pure integer function piece_of(self, k)
    class(mesh_type), intent(in) :: self
    integer(i8), intent(in) :: k
    integer :: low, high, middle
    low = 1
    high = size(self%ends)
    do while (low < high)
      middle = (low + high)/2
      if (k < self%made_by(middle)) then
        high = middle
      else
        low = middle + 1
      end if
    end do
    piece_of = low
  end function piece_of

  !> True if step k+1 is the first of this piece.
  pure logical function begins(self, piece, k)
    class(mesh_type), intent(in) :: self
    integer, intent(in) :: piece
    integer(i8), intent(in) :: k
    begins = k == 0
    if (piece > 1) begins = k == self%made_by(piece - 1)
  end function begins

  !> Number of the steps first+1 ... first+n that end by a time within or after the piece.
  pure integer(i8) function made_until(self, piece, first, n, t) result(made)
    class(mesh_type), intent(in) :: self
    integer, intent(in) :: piece
    integer(i8), intent(in) :: first, n
    real(wp), intent(in) :: t
    made = n
    do while (made > 0)
      if (self%time(piece, first + made) <= t) exit
      made = made - 1
    end do
  end function made_until

  !> Time after k steps, the last of them in a piece.
  pure real(wp) function time(self, piece, k)
    class(mesh_type), intent(in) :: self
    integer, intent(in) :: piece
    integer(i8), intent(in) :: k
    if (k == self%made_by(piece)) then
      time = self%ends(piece)
    else if (piece == 1) then
      time = real(k, wp)*self%h(1)
    else
      time = self%ends(piece - 1) + real(k - self%made_by(piece - 1), wp)*self%h(piece)
    end if
  end function time

  !> Time after k steps, as computed by the run that made them.
  pure real(wp) function start_of(self, k)
    class(mesh_type), intent(in) :: self
    integer(i8), intent(in) :: k
    start_of = 0.0_wp
    if (k > 0) start_of = self%time(self%piece_of(k - 1), k)
  end function start_of

  !> Time at which a piece begins.
  pure real(wp) function beginning(self, piece)
    class(mesh_type), intent(in) :: self
    integer, intent(in) :: piece
    beginning = 0.0_wp
    if (piece > 1) beginning = self%ends(piece - 1)
  end function beginning

end module viscovib_mesh
