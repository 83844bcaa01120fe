!> The part of Hill's matrix that goes through hereditary variables where F(u, v) is not separable:
!! (b + B) f (w + W), b and w being what varies along the solution of dF/dv and dw/du, times
!! M^(-1).
module viscovib_hill_products
  use viscovib_band_elimination, only: add_column
  use viscovib_hill_blocks, only: add_toeplitz, moments_of
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: hill_products

  type :: hill_products
    private
    !> b and w of coordinate and variable, shape (p, p, n, m, 2), real parts first, imaginary parts
    !! second in the last index, and whether anything of them varies.
    real(wp), allocatable :: outer(:, :, :, :, :), inner(:, :, :, :, :)
    logical, allocatable :: outer_varies(:, :), inner_varies(:, :)
  contains
    procedure :: fill
    procedure :: add
    procedure, private :: add_product
  end type hill_products

contains

  !> For p orders.
  subroutine fill(self, p, system, waves, inverse, slopes, by_v)
    class(hill_products), intent(inout) :: self
    integer, intent(in) :: p
    class(oscillator_type), intent(in) :: system
    !> exp(-2 pi i m/n)/n at m = 0, 1, ..., n samples.
    complex(wp), intent(in) :: waves(0:)
    !> M^(-1), and slopes of w and F at the samples, shapes (n, m, n) and (n, n, m).
    real(wp), intent(in) :: inverse(:, :), slopes(:, :, :), by_v(:, :, :)
    complex(wp) :: c(-p:p)
    real(wp) :: turned(size(slopes, 1))
    integer :: a, j, n, m

    n = size(inverse, 1)
    m = size(by_v, 3)
    if (allocated(self%outer)) then
      if (size(self%outer, 1) /= p) deallocate (self%outer, self%inner)
    end if
    if (.not. allocated(self%outer)) allocate (self%outer(p, p, n, m, 2), self%inner(p, p, n, m, 2))
    self%outer = 0.0_wp
    self%inner = 0.0_wp
    if (.not. allocated(self%outer_varies)) then
      allocate (self%outer_varies(n, m), self%inner_varies(n, m))
    end if
    do a = 1, n
      do j = 1, m
        turned = matmul(by_v(:, :, j), inverse(a, :))
        self%outer_varies(a, j) = any(abs(turned) > 0.0_wp)
        if (self%outer_varies(a, j)) then
          call moments_of(waves, .true., turned, 0.0_wp, c)
          call add_toeplitz(p, c, p, self%outer(1, 1, a, j, 1), self%outer(1, 1, a, j, 2))
        end if
        self%inner_varies(a, j) = system%bent(j) .and. any(abs(slopes(:, j, a)) > 0.0_wp)
        if (self%inner_varies(a, j)) then
          call moments_of(waves, .true., slopes(:, j, a), 0.0_wp, c)
          call add_toeplitz(p, c, p, self%inner(1, 1, a, j, 1), self%inner(1, 1, a, j, 2))
        end if
      end do
    end do
  end subroutine fill

  !> Add (b + B) f (w + W) of the highest orders, as many as `kept` has.
  subroutine add(self, system, spread, group, kept, h)
    class(hill_products), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    !> M^(-1) B, shape (n, m), and the column of `kept` that holds f of each variable.
    real(wp), intent(in) :: spread(:, :)
    integer, intent(in) :: group(:)
    complex(wp), intent(in) :: kept(:, :)
    real(wp), intent(inout) :: h(size(kept, 1)*size(spread, 1), size(kept, 1)*size(spread, 1), 2)
    real(wp) :: right(size(kept, 1), size(kept, 1), 2)
    integer :: a, b, j, l, o, p

    p = size(kept, 1)
    o = size(self%inner, 1) - p
    do j = 1, size(spread, 2)
      associate (f => kept(:, group(j)))
        do b = 1, size(spread, 1)
          if (.not. (self%inner_varies(b, j) .or. abs(system%gather(j, b)) > 0.0_wp)) cycle
          do l = 1, p
            right(:, l, 1) = real(f)*self%inner(o + 1:, o + l, b, j, 1) &
                             - aimag(f)*self%inner(o + 1:, o + l, b, j, 2)
            right(:, l, 2) = real(f)*self%inner(o + 1:, o + l, b, j, 2) &
                             + aimag(f)*self%inner(o + 1:, o + l, b, j, 1)
            right(l, l, 1) = right(l, l, 1) + real(f(l))*system%gather(j, b)
            right(l, l, 2) = right(l, l, 2) + aimag(f(l))*system%gather(j, b)
          end do
          do a = 1, size(spread, 1)
            call self%add_product(f, right, a, b, j, system%gather(j, b), spread(a, j), h)
          end do
        end do
      end associate
    end do
  end subroutine add

  !> Add (b + B) f (w + W) of hereditary variable j to its block of coordinates a and b.
  subroutine add_product(self, kept, right, a, b, j, gather, spread, h)
    class(hill_products), intent(in) :: self
    complex(wp), intent(in) :: kept(:)
    !> f (w + W); W and M^(-1) B of these.
    real(wp), intent(in) :: right(:, :, :), gather, spread
    integer, intent(in) :: a, b, j
    real(wp), intent(inout) :: h(size(kept)*size(self%inner, 3), size(kept)*size(self%inner, 3), 2)
    complex(wp) :: f
    integer :: i, l, o, p, row, column

    p = size(kept)
    o = size(self%inner, 1) - p
    row = (a - 1)*p
    column = (b - 1)*p
    if (abs(spread) > 0.0_wp) then
      h(row + 1:row + p, column + 1:column + p, :) = &
        h(row + 1:row + p, column + 1:column + p, :) + spread*right
    end if
    if (.not. self%outer_varies(a, j)) return
    do l = 1, p
      if (.not. self%inner_varies(b, j)) then
        call add_column(p, kept(l)*gather, self%outer(o + 1, o + l, a, j, 1), &
                        self%outer(o + 1, o + l, a, j, 2), h(row + 1, column + l, 1), &
                        h(row + 1, column + l, 2))
        cycle
      end if
      do i = 1, p
        f = cmplx(right(i, l, 1), right(i, l, 2), wp)
        call add_column(p, f, self%outer(o + 1, o + i, a, j, 1), &
                        self%outer(o + 1, o + i, a, j, 2), h(row + 1, column + l, 1), &
                        h(row + 1, column + l, 2))
      end do
    end do
  end subroutine add_product

end module viscovib_hill_products
