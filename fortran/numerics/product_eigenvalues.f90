!> Eigenvalues of a long product of matrices, with the same relative accuracy for all.
!!
!! Eigenvalues of M = F_m ... F_1 below epsilon times the largest are lost if the product is formed.
!! Here its factors are kept: F_k Q_(k-1) = Q_k R_k with orthogonal Q and triangular R, repeatedly
!! from Q_0 = Q_m until the spaces of the first columns of Q_0 are mapped onto themselves.
!! Q_0' Q_m is then block diagonal, and R is block triangular. Each block of
!! (Q_0' Q_m) R_m ... R_1 has eigenvalues of one size, which are computed separately (the periodic
!! QR iteration without shifts: Bojanczyk, Golub, Van Dooren, Proc. SPIE 1770 (1992) 31; Dieci,
!! Russell, Van Vleck, SIAM J. Numer. Anal. 34 (1997) 402).
module viscovib_product_eigenvalues
  use, intrinsic :: ieee_arithmetic, only: ieee_negative_inf, ieee_value
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: product_type, product_eigenvalues

  !> Growth of a product at which the next factor begins, so that directions that shrink at the same
  !! time are not lost in its rounding error.
  real(wp), parameter, public :: largest_factor = 30.0_wp
  !> Allowed coupling of a block with those before it.
  real(wp), parameter :: separate = 1.0e-10_wp
  !> Smallest and largest number of iterations through all factors; eigenvalues whose logarithms
  !! differ by less than `alike` stay in one block.
  integer, parameter :: least_turns = 3, max_turns = 80
  real(wp), parameter :: alike = 0.4_wp
  !> Largest ratio of a block's product to its eigenvalues; above it they are inaccurate.
  real(wp), parameter :: most_lost = 1.0e7_wp

  !> The factors of a product; the first one is applied first.
  type :: product_type
    integer :: n_factors = 0
    !> Shape (n, n, n_factors or more).
    real(wp), allocatable :: factors(:, :, :)
  contains
    procedure :: append
  end type product_type

contains

  !> Append a factor, to be applied after those before it.
  pure subroutine append(self, factor)
    class(product_type), intent(inout) :: self
    !> Shape (n, n).
    real(wp), intent(in) :: factor(:, :)
    real(wp), allocatable :: more(:, :, :)
    integer :: n

    n = size(factor, 1)
    if (.not. allocated(self%factors)) allocate (self%factors(n, n, 8))
    if (self%n_factors == size(self%factors, 3)) then
      allocate (more(n, n, 2*self%n_factors))
      more(:, :, :self%n_factors) = self%factors
      call move_alloc(more, self%factors)
    end if
    self%n_factors = self%n_factors + 1
    self%factors(:, :, self%n_factors) = factor
  end subroutine append

  !> Logarithms of the eigenvalues, largest first, pairs adjacent; the real part is minus
  !! infinity for 0.
  pure subroutine product_eigenvalues(product, logs, found)
    type(product_type), intent(in) :: product
    !> Shape (n).
    complex(wp), intent(out) :: logs(:)
    logical, intent(out) :: found
    real(wp), dimension(size(logs), size(logs)) :: q, start, turned
    real(wp) :: sizes(size(logs))
    integer :: i, j, turn, first(size(logs) + 1), n_blocks
    logical :: done

    logs = (0.0_wp, 0.0_wp)
    ! No special direction: uncoupled coordinates must be sorted too.
    do j = 1, size(logs)
      do i = 1, size(logs)
        q(i, j) = sin(real(i*i + 2*i*j, wp)) + merge(1.0_wp, 0.0_wp, i == j)
      end do
    end do
    call orthogonalise(q, turned)
    do turn = 1, max_turns
      start = q
      call go_through(product, q, sizes, found)
      if (.not. found) return
      turned = matmul(transpose(start), q)
      call divide(turned, sizes, turn, first, n_blocks, done)
      if (done .and. turn >= least_turns) exit
    end do
    do i = 1, n_blocks
      call block_eigenvalues(product, start, first(i), first(i + 1) - 1, turned, &
                             logs(first(i):first(i + 1) - 1), found)
      if (.not. found) return
    end do
    call sort_falling(logs, real(logs))
  end subroutine product_eigenvalues

  !> Advance Q through all factors; logarithms of the diagonal of the product of the R.
  pure subroutine go_through(product, q, sizes, found)
    type(product_type), intent(in) :: product
    real(wp), intent(inout) :: q(:, :)
    real(wp), intent(out) :: sizes(:)
    logical, intent(out) :: found
    real(wp) :: r(size(q, 1), size(q, 1))
    integer :: i, k

    sizes = 0.0_wp
    found = .true.
    do k = 1, product%n_factors
      q = matmul(product%factors(:, :, k), q)
      call orthogonalise(q, r)
      do i = 1, size(sizes)
        found = r(i, i) > 0.0_wp
        if (.not. found) return
        sizes(i) = sizes(i) + log(r(i, i))
      end do
    end do
  end subroutine go_through

  !> A = Q R, with Q stored in A and a positive diagonal of R; each column is processed twice, so
  !! that Q is orthogonal to rounding for any A.
  pure subroutine orthogonalise(a, r)
    real(wp), intent(inout) :: a(:, :)
    real(wp), intent(out) :: r(:, :)
    real(wp) :: part
    integer :: i, j, pass

    r = 0.0_wp
    do j = 1, size(a, 2)
      do pass = 1, 2
        do i = 1, j - 1
          part = dot_product(a(:, i), a(:, j))
          a(:, j) = a(:, j) - part*a(:, i)
          r(i, j) = r(i, j) + part
        end do
      end do
      r(j, j) = norm2(a(:, j))
      if (.not. r(j, j) > 0.0_wp) return
      a(:, j) = a(:, j)/r(j, j)
    end do
  end subroutine orthogonalise

  !> First columns of the blocks of Q_0' Q_m; `done`: the remaining coupling is accepted.
  pure subroutine divide(turned, sizes, turn, first, n_blocks, done)
    real(wp), intent(in) :: turned(:, :), sizes(:)
    integer, intent(in) :: turn
    integer, intent(out) :: first(:), n_blocks
    logical, intent(out) :: done
    integer :: j

    n_blocks = 1
    first(1) = 1
    done = .true.
    do j = 2, size(sizes)
      if (maxval(abs(turned(j:, :j - 1))) <= separate) then
        n_blocks = n_blocks + 1
        first(n_blocks) = j
      else if (abs(sizes(j - 1) - sizes(j)) > alike .or. turn < least_turns) then
        done = .false.
      end if
    end do
    first(n_blocks + 1) = size(sizes) + 1
  end subroutine divide

  !> Eigenvalues of the block in columns low to high.
  pure subroutine block_eigenvalues(product, start, low, high, turned, logs, found)
    type(product_type), intent(in) :: product
    real(wp), intent(in) :: start(:, :), turned(:, :)
    integer, intent(in) :: low, high
    complex(wp), intent(out) :: logs(:)
    logical, intent(out) :: found
    real(wp) :: q(size(start, 1), size(start, 1)), r(size(start, 1), size(start, 1))
    real(wp) :: whole(high - low + 1, high - low + 1), unit, power
    complex(wp) :: values(high - low + 1)
    integer :: i, k

    q = start
    whole = 0.0_wp
    do i = 1, size(whole, 1)
      whole(i, i) = 1.0_wp
    end do
    power = 0.0_wp
    do k = 1, product%n_factors
      q = matmul(product%factors(:, :, k), q)
      call orthogonalise(q, r)
      whole = matmul(r(low:high, low:high), whole)
      unit = maxval(abs(whole))
      whole = whole/unit
      power = power + log(unit)
    end do
    whole = matmul(turned(low:high, low:high), whole)
    call eigenvalues(whole, values, found)
    if (.not. found) return
    found = minval(abs(values))*most_lost >= maxval(abs(whole))
    do i = 1, size(values)
      if (abs(values(i)) > 0.0_wp) then
        logs(i) = power + log(values(i))
      else
        logs(i) = cmplx(ieee_value(0.0_wp, ieee_negative_inf), 0.0_wp, wp)
      end if
    end do
  end subroutine block_eigenvalues

end module viscovib_product_eigenvalues
