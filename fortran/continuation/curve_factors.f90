! Optimize: -O2
!> Factors of the derivatives along a curve, bordered by slope and tangent.
!!
!! Unknowns come in blocks, such as the harmonics of each coordinate. Those of linear coordinates
!! couple to other blocks only in pairs, harmonic by harmonic. They are eliminated first, one pair
!! of each linear block at a time, A x + B y = a, C x + D y = b: (D - C A^-1 B) y = b - C A^-1 a and
!! x = A^-1 (a - B y). If entries of A^-1 B are large, as near a resonance of the linear subsystem,
!! pivots would be small: these pairs are not eliminated.
module viscovib_curve_factors
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_dense, only: factorize, factorize_padded, solve, solve_columns, solve_padded
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_factors, new_factors

  !> Up to this number of unknowns, vectorized padded columns are faster than blocks.
  integer, parameter :: small = 64, vector = 8
  !> Largest entry of A^-1 B in the units of the unknowns.
  real(wp), parameter :: most_growth = 30.0_wp

  type :: curve_factors
    !> Unknowns including the parameter, and padded rows of the matrix.
    integer :: n = 0, rows = 0
    real(wp), allocatable :: matrix(:, :)
    integer, private :: blocks = 1
    integer, allocatable, private :: pivots(:)
    !> Unknowns that remain after the elimination: indices, and factors; empty without an
    !! elimination.
    integer, allocatable, private :: left(:), left_pivots(:)
    real(wp), allocatable, private :: rest(:, :)
    type(pair_factors), allocatable, private :: pairs(:)
  contains
    procedure :: decompose
    procedure :: solve => solve_bordered
    procedure :: determinant
    procedure :: pivots_of
  end type curve_factors

  !> A pair of each eliminated block: its unknowns, the remaining unknowns that it couples to, the
  !! factors of A, A^-1 B, and C.
  type :: pair_factors
    integer, allocatable :: own(:), met(:), pivots(:)
    real(wp), allocatable :: a(:, :), inverse_b(:, :), c(:, :)
  end type pair_factors

contains

  !> Create factors for n unknowns in blocks of equal length, and a parameter.
  subroutine new_factors(self, n, blocks)
    type(curve_factors), intent(out) :: self
    integer, intent(in) :: n, blocks
    self%n = n + 1
    self%blocks = blocks
    self%rows = self%n
    if (n < small) self%rows = (n/vector + 1)*vector
    allocate (self%matrix(self%rows, self%n), source=0.0_wp)
    allocate (self%pivots(self%n), self%left(0), self%pairs(0))
  end subroutine new_factors

  !> Factorize the matrix.
  subroutine decompose(self, sizes, singular)
    class(curve_factors), intent(inout) :: self
    !> Typical size of each unknown, shape (n).
    real(wp), intent(in) :: sizes(:)
    logical, intent(out) :: singular

    if (self%n - 1 < small) then
      call factorize_padded(self%rows, self%n, self%matrix, self%pivots, singular)
    else
      call decompose_many(self, sizes, singular)
    end if
  end subroutine decompose

  !> The same for many unknowns.
  subroutine decompose_many(self, sizes, singular)
    class(curve_factors), intent(inout) :: self
    real(wp), intent(in) :: sizes(:)
    logical, intent(out) :: singular
    logical :: loose(self%blocks)

    self%left = [integer ::]
    loose = .false.
    if (self%blocks > 1) call find_loose(self%n - 1, self%blocks, self%rows, self%matrix, loose)
    if (any(loose) .and. .not. all(loose)) then
      call eliminate_pairs(self, loose, sizes)
      if (size(self%pairs) > 0) then
        call factorize(size(self%left), self%rest, self%left_pivots, singular)
        return
      end if
    end if
    call factorize_blocks(self%n, self%matrix, self%pivots, singular)
  end subroutine decompose_many

  !> Find the blocks that couple to all blocks in pairs only.
  pure subroutine find_loose(n, blocks, rows, matrix, loose)
    integer, intent(in) :: n, blocks, rows
    real(wp), intent(in) :: matrix(rows, *)
    logical, intent(out) :: loose(blocks)
    logical :: tied(blocks, blocks)
    integer :: i, j, a, b, m, at

    m = n/blocks
    tied = mod(m, 2) /= 0
    do b = 1, blocks
      do j = 1, m
        do a = 1, blocks
          if (tied(a, b)) cycle
          at = (a - 1)*m + 2*((j - 1)/2)
          do i = (a - 1)*m + 1, at
            if (abs(matrix(i, (b - 1)*m + j)) > 0.0_wp) tied(a, b) = .true.
          end do
          do i = at + 3, a*m
            if (abs(matrix(i, (b - 1)*m + j)) > 0.0_wp) tied(a, b) = .true.
          end do
        end do
      end do
    end do
    loose = .not. (any(tied, 1) .or. any(tied, 2))
  end subroutine find_loose

  !> Eliminate the linear coordinates, pair by pair.
  subroutine eliminate_pairs(self, loose, sizes)
    class(curve_factors), intent(inout) :: self
    logical, intent(in) :: loose(:)
    real(wp), intent(in) :: sizes(:)
    type(pair_factors) :: pair
    integer :: place(self%n), b, i, j, k, m, n_pairs
    logical :: gone(self%n), fine

    m = (self%n - 1)/(2*self%blocks)
    deallocate (self%pairs)
    allocate (self%pairs(m))
    n_pairs = 0
    gone = .false.
    do k = 1, m
      pair%own = [integer ::]
      pair%met = [integer ::]
      do b = 1, self%blocks
        i = 2*(k + m*(b - 1))
        if (loose(b)) then
          pair%own = [pair%own, i - 1, i]
        else
          pair%met = [pair%met, i - 1, i]
        end if
      end do
      pair%met = [pair%met, self%n]
      call make_pair(self%matrix, sizes, pair, fine)
      if (.not. fine) cycle
      n_pairs = n_pairs + 1
      self%pairs(n_pairs) = pair
      gone(pair%own) = .true.
    end do
    self%pairs = self%pairs(:n_pairs)
    ! Without pairs the whole matrix is factorized, and `left` remains empty.
    if (n_pairs == 0) return
    self%left = pack([(i, i=1, self%n)], .not. gone)
    place(self%left) = [(i, i=1, size(self%left))]
    if (allocated(self%rest)) deallocate (self%rest, self%left_pivots)
    allocate (self%rest(size(self%left), size(self%left)), self%left_pivots(size(self%left)))
    do j = 1, size(self%left)
      do i = 1, size(self%left)
        self%rest(i, j) = self%matrix(self%left(i), self%left(j))
      end do
    end do
    do k = 1, n_pairs
      associate (one => self%pairs(k))
        one%met = place(one%met)
        self%rest(one%met, one%met) = self%rest(one%met, one%met) - matmul(one%c, one%inverse_b)
      end associate
    end do
  end subroutine eliminate_pairs

  !> Factors of a pair; `fine` is false if it cannot be eliminated.
  subroutine make_pair(matrix, sizes, pair, fine)
    real(wp), intent(in) :: matrix(:, :), sizes(:)
    type(pair_factors), intent(inout) :: pair
    logical, intent(out) :: fine
    integer :: n, m, i, j
    logical :: singular

    n = size(pair%own)
    m = size(pair%met)
    pair%a = matrix(pair%own, pair%own)
    pair%inverse_b = matrix(pair%own, pair%met)
    pair%c = matrix(pair%met, pair%own)
    if (allocated(pair%pivots)) deallocate (pair%pivots)
    allocate (pair%pivots(n))
    call factorize(n, pair%a, pair%pivots, singular)
    fine = .not. singular
    if (singular) return
    call solve_columns(n, m, pair%a, pair%pivots, pair%inverse_b)
    do j = 1, m
      do i = 1, n
        fine = fine .and. abs(pair%inverse_b(i, j))*sizes(pair%met(j)) &
               <= most_growth*sizes(pair%own(i))
      end do
    end do
  end subroutine make_pair

  !> Solve the system; x is the right-hand side on entry.
  subroutine solve_bordered(self, x)
    class(curve_factors), intent(in) :: self
    real(wp), intent(inout) :: x(self%n)
    if (size(self%left) == 0) then
      call solve_padded(self%rows, self%n, self%matrix, self%pivots, x)
    else
      call solve_reduced(self, x)
    end if
  end subroutine solve_bordered

  !> The same after an elimination.
  subroutine solve_reduced(self, x)
    class(curve_factors), intent(in) :: self
    real(wp), intent(inout) :: x(self%n)
    real(wp) :: y(size(self%left))
    integer :: k

    y = x(self%left)
    do k = 1, size(self%pairs)
      call solve_first(self%pairs(k))
    end do
    call solve(size(self%left), self%rest, self%left_pivots, y)
    do k = 1, size(self%pairs)
      associate (one => self%pairs(k))
        x(one%own) = x(one%own) - matmul(one%inverse_b, y(one%met))
      end associate
    end do
    x(self%left) = y

  contains

    subroutine solve_first(one)
      type(pair_factors), intent(in) :: one
      real(wp) :: own(size(one%own))
      own = x(one%own)
      call solve(size(own), one%a, one%pivots, own)
      y(one%met) = y(one%met) - matmul(one%c, own)
      x(one%own) = own
    end subroutine solve_first

  end subroutine solve_reduced

  !> Sign of the determinant and, if requested, the logarithm of its magnitude, else 0. Equations
  !! and unknowns have the same order, which changes no sign.
  subroutine determinant(self, wanted, sign, logarithm)
    class(curve_factors), intent(in) :: self
    logical, intent(in) :: wanted
    integer, intent(out) :: sign
    real(wp), intent(out) :: logarithm
    integer :: k

    sign = 1
    logarithm = 0.0_wp
    if (size(self%left) == 0) then
      call add_factors(self%n, self%matrix, self%pivots)
      return
    end if
    call add_factors(size(self%left), self%rest, self%left_pivots)
    do k = 1, size(self%pairs)
      associate (one => self%pairs(k))
        call add_factors(size(one%own), one%a, one%pivots)
      end associate
    end do

  contains

    subroutine add_factors(n, matrix, pivots)
      integer, intent(in) :: n, pivots(n)
      real(wp), intent(in) :: matrix(:, :)
      integer :: i
      do i = 1, n
        if (pivots(i) /= i) sign = -sign
        if (matrix(i, i) < 0.0_wp) sign = -sign
        if (wanted) logarithm = logarithm + log(abs(matrix(i, i)))
      end do
    end subroutine add_factors

  end subroutine determinant

  !> Largest and smallest of the pivots, in the units of unknowns and equations.
  subroutine pivots_of(self, sizes, largest_of, largest, smallest)
    class(curve_factors), intent(in) :: self
    !> Sizes of the unknowns and of the equations, shapes (n).
    real(wp), intent(in) :: sizes(:)
    !> Changed to the order of the pivots, or unchanged.
    real(wp), intent(inout) :: largest_of(:)
    real(wp), intent(out) :: largest, smallest
    real(wp), allocatable :: rows(:)
    integer :: k

    largest = 0.0_wp
    smallest = huge(smallest)
    if (size(self%left) == 0) then
      call look(self%matrix, self%pivots, sizes, largest_of)
      return
    end if
    rows = largest_of(self%left)
    call look(self%rest, self%left_pivots, sizes(self%left), rows)
    do k = 1, size(self%pairs)
      associate (one => self%pairs(k))
        rows = largest_of(one%own)
        call look(one%a, one%pivots, sizes(one%own), rows)
      end associate
    end do

  contains

    subroutine look(matrix, pivots, size_of, row)
      real(wp), intent(in) :: matrix(:, :), size_of(:)
      integer, intent(in) :: pivots(:)
      real(wp), intent(inout) :: row(:)
      real(wp) :: one, pivot
      integer :: i
      do i = 1, size(row)
        ! Apply the row exchanges.
        one = row(pivots(i))
        row(pivots(i)) = row(i)
        pivot = abs(matrix(i, i))*size_of(i)/one
        smallest = min(smallest, pivot)
        largest = max(largest, pivot)
      end do
    end subroutine look

  end subroutine pivots_of

end module viscovib_curve_factors
