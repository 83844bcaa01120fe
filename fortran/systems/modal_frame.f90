! Optimize: -O1
!> Modal coordinates of the linear subsystem ("sections"), which are integrated exactly in time.
!!
!! With u = Phi x the linear subsystem M u'' + C u' + K u = p becomes
!!
!!   x_m'' + rate_m x_m' + square_m x_m = (Phi^-1 M^-1 p)_m - (N x)_m - (D x')_m.
!!
!! Phi contains the mass-normalized modes of M and the symmetric part of K; rate is the diagonal of
!! Phi^T C Phi. N and D are the remaining parts of K and C; they are 0 for symmetric K and modal
!! damping. A coordinate without stiffness and mass coupling, such as a memory variable
!! (viscovib_hidden_memory), is a section of its own.
module viscovib_modal_frame
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: lane_table, new_lane_table
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: has_frame, is_definite, modal_frame, new_modal_frame

  !> Largest number of coordinates of a frame.
  integer, parameter, public :: most_in_frame = 512
  !> The same together with exponentials of memory.
  integer, parameter, public :: most_with_memory = 1024
  !> Entries below this fraction of the terms in their sum count as rounding errors.
  real(wp), parameter :: rounding = 1.0e-14_wp

  type :: modal_frame
    !> Phi^T, shape (n, n), columns: coordinates, x -> u; and (Phi^-1)^T, columns: sections.
    type(lane_table) :: to_coordinates, to_sections
    !> Shape (n).
    real(wp), allocatable :: squares(:), rates(:)
    !> Sections whose displacements no force depends on, shape (n). They are kept at 0.
    logical, allocatable :: unseen(:)
    !> The first of the unseen sections with the same rate, but for rounding errors; other
    !! sections: themselves. Shape (n).
    integer, allocatable :: like(:)
    !> N^T and D^T, shape (n, n); not allocated: 0.
    type(lane_table), allocatable :: coupling, drag
  contains
    procedure :: pace
    procedure :: sum_of_sizes
  end type modal_frame

contains

  !> True if a symmetric matrix is numerically positive definite.
  pure logical function is_definite(matrix)
    real(wp), intent(in) :: matrix(:, :)
    !> Smallest pivot, as a fraction of the diagonal entry.
    real(wp), parameter :: least = 1.0e-10_wp
    real(wp) :: l(size(matrix, 1), size(matrix, 1)), left
    integer :: i, j

    is_definite = .false.
    l = 0.0_wp
    do j = 1, size(matrix, 1)
      left = matrix(j, j) - sum(l(j, :j - 1)**2)
      if (.not. left > least*matrix(j, j)) return
      do i = j, size(matrix, 1)
        l(i, j) = (matrix(i, j) - sum(l(i, :j - 1)*l(j, :j - 1)))/sqrt(left)
      end do
    end do
    is_definite = .true.
  end function is_definite

  !> True if a mass matrix (n, n) is symmetric and positive definite, as modal coordinates require.
  pure logical function has_frame(mass)
    real(wp), intent(in) :: mass(:, :)
    has_frame = all(abs(mass - transpose(mass)) <= rounding*maxval(abs(mass)))
    if (has_frame) has_frame = is_definite(mass)
  end function has_frame

  subroutine new_modal_frame(frame, mass, damping, stiffness, n_hidden, found)
    type(modal_frame), intent(out) :: frame
    !> M, C and K, shape (n, n).
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    !> Number of last coordinates that represent memory.
    integer, intent(in) :: n_hidden
    !> False if M is not symmetric and positive definite.
    logical, intent(out) :: found
    real(wp), dimension(size(mass, 1), size(mass, 1)) :: shapes, left
    real(wp), allocatable :: own_shapes(:, :), part(:, :), squares(:), sections(:, :)
    integer, allocatable :: own(:)
    logical :: alone(size(mass, 1))
    integer :: i, j, n

    n = size(mass, 1)
    do i = 1, n
      alone(i) = all(abs(stiffness(:, i)) <= 0.0_wp) &
                 .and. count(abs(mass(:, i)) > 0.0_wp) == 1 &
                 .and. count(abs(mass(i, :)) > 0.0_wp) == 1 .and. mass(i, i) > 0.0_wp
    end do
    own = pack([(i, i=1, n)], .not. alone)
    allocate (frame%unseen(n), source=.false.)
    frame%unseen(n - n_hidden + 1:) = .true.
    allocate (frame%squares(n), source=0.0_wp)
    allocate (own_shapes(size(own), size(own)), squares(size(own)))
    found = has_frame(mass(own, own))
    if (.not. found) return
    associate (k => stiffness(own, own))
      call find_symmetric_modes(mass(own, own), 0.5_wp*(k + transpose(k)), squares, own_shapes)
    end associate
    shapes = 0.0_wp
    shapes(own, own) = own_shapes
    frame%squares(own) = squares
    allocate (sections(n, n), source=0.0_wp)
    sections(own, own) = matmul(mass(own, own), own_shapes)
    do i = 1, n
      if (.not. alone(i)) cycle
      shapes(i, i) = 1.0_wp/sqrt(mass(i, i))
      sections(i, i) = sqrt(mass(i, i))
    end do
    call new_lane_table(frame%to_coordinates, transpose(shapes))
    call new_lane_table(frame%to_sections, sections)
    left = stiffness
    left(own, own) = 0.5_wp*(stiffness(own, own) - transpose(stiffness(own, own)))
    where (abs(left) <= rounding*(abs(stiffness) + abs(transpose(stiffness)))) left = 0.0_wp
    call take_part(left, shapes, own, part)
    call keep(part, frame%coupling)
    call take_part(damping, shapes, own, part)
    allocate (frame%rates(n), source=0.0_wp)
    do i = 1, n
      frame%rates(i) = part(i, i)
      part(i, i) = 0.0_wp
    end do
    call keep(part, frame%drag)
    frame%like = [(i, i=1, n)]
    do i = n - n_hidden + 1, n
      do j = n - n_hidden + 1, i - 1
        if (abs(frame%rates(j) - frame%rates(i)) > 4.0_wp*epsilon(1.0_wp)*frame%rates(i)) cycle
        frame%like(i) = j
        exit
      end do
    end do
  end subroutine new_modal_frame

  !> Largest rate sqrt(stiffness/mass) (rad/s) of all coordinates together and of each deflection in
  !! laws. The sections do not limit the step size, but these rates do.
  pure real(wp) function pace(self, seen)
    class(modal_frame), intent(in) :: self
    !> Deflections by coordinates, shape (n_seen, n).
    real(wp), intent(in) :: seen(:, :)
    real(wp), dimension(size(self%squares)) :: soft, part
    real(wp) :: softest, heaviest, square
    integer :: i

    soft = abs(self%squares)
    soft = merge(1.0_wp, 0.0_wp, soft > 0.0_wp)/merge(soft, 1.0_wp, soft > 0.0_wp)
    softest = 0.0_wp
    heaviest = 0.0_wp
    do i = 1, count(.not. self%unseen)
      softest = max(softest, sum(soft*self%to_coordinates%values(:, i)**2))
      heaviest = max(heaviest, sum(self%to_coordinates%values(:, i)**2))
    end do
    square = 0.0_wp
    if (softest > 0.0_wp) square = heaviest/softest
    do i = 1, size(seen, 1)
      part = matmul(self%to_coordinates%values, seen(i, :))**2
      softest = sum(soft*part)
      if (softest > 0.0_wp) square = max(square, sum(part)/softest)
    end do
    pace = sqrt(square)
  end function pace

  !> Sum of the absolute contributions of sections to a deflection n . u, a scale for its rounding
  !! error.
  pure real(wp) function sum_of_sizes(self, u, n)
    class(modal_frame), intent(in) :: self
    real(wp), intent(in) :: u(:), n(:)
    sum_of_sizes = sum(abs(self%to_sections%row(u)*matmul(self%to_coordinates%values, n)))
  end function sum_of_sizes

  !> Keep a matrix that is not 0.
  subroutine keep(values, table)
    real(wp), intent(in) :: values(:, :)
    type(lane_table), allocatable, intent(out) :: table
    if (.not. any(abs(values) > 0.0_wp)) return
    allocate (table)
    call new_lane_table(table, values)
  end subroutine keep

  !> (Phi^T A Phi)^T with rounding errors set to 0.
  subroutine take_part(a, shapes, own, part)
    !> Outside of rows and columns `own` Phi is a diagonal matrix.
    real(wp), intent(in) :: a(:, :), shapes(:, :)
    integer, intent(in) :: own(:)
    real(wp), allocatable, intent(out) :: part(:, :)
    real(wp), dimension(size(a, 1), size(a, 1)) :: sizes

    part = transpose(a)
    sizes = abs(part)
    call turn(part, shapes, own)
    call turn(sizes, abs(shapes), own)
    where (abs(part) <= rounding*sizes) part = 0.0_wp
  end subroutine take_part

  !> A := Phi^T A Phi.
  subroutine turn(a, shapes, own)
    real(wp), intent(inout) :: a(:, :)
    real(wp), intent(in) :: shapes(:, :)
    integer, intent(in) :: own(:)
    real(wp) :: rows(size(own), size(a, 2)), columns(size(a, 1), size(own))
    integer :: i

    rows = matmul(transpose(shapes(own, own)), a(own, :))
    do i = 1, size(a, 1)
      a(i, :) = shapes(i, i)*a(i, :)
    end do
    a(own, :) = rows
    columns = matmul(a(:, own), shapes(own, own))
    do i = 1, size(a, 1)
      a(:, i) = shapes(i, i)*a(:, i)
    end do
    a(:, own) = columns
  end subroutine turn

end module viscovib_modal_frame
