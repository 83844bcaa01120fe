! Optimize: -O2 -fvect-cost-model=dynamic
!> The compliance that swinging deflections of a condensed structure meet, by the modes of its rest.
!!
!! The rest H = c^T R b has R = diag[1/(a_m + r_m s + s^2)], c sees and b feels the deflections.
!! Where these are more than the modes, the linear memory of the deflections P that do not swing is
!! eliminated in the modes: with I + X Y and I + Y X of one determinant, and A those that swing,
!!
!!   E = R^-1 + b_P J_P. c^T,   det(I + J_P. H_.P) = det E/det R^-1,   H' = c_A^T E^-1 b_A.
!!
!! All orders s_k are eliminated side by side, without exchanges of rows: an order that would need
!! one is refused.
module viscovib_condensed_modes
  use viscovib_compliance_band, only: compliance_band
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: modal_rest

  !> Of what stands below it: a pivot this small wants rows exchanged.
  real(wp), parameter :: weak = 1.0e-2_wp

  type :: modal_rest
    !> Whether this is possible, and less work than by deflections.
    logical :: serves = .false.
    !> a and r, shape (n_modes), c_A and b_A, shape (n_modes, n_swings).
    real(wp), allocatable, private :: squares(:), rates(:), seen(:, :), pushed(:, :)
    !> b_P J_P. c^T of each group and less, shape (n_modes, n_modes, 0:groups), and J_A. c^T, shape
    !! (n_swings, n_modes, 0:groups).
    real(wp), allocatable, private :: carried(:, :, :), own(:, :, :)
  contains
    procedure :: prepare
    procedure :: remaining
  end type modal_rest

contains

  !> For one motion.
  subroutine prepare(self, band, swings, others, mean, without)
    class(modal_rest), intent(inout) :: self
    type(compliance_band), intent(in) :: band
    !> A and P.
    integer, intent(in) :: swings(:), others(:)
    !> Mean of J of each group, shape (n, n, groups), and what it is less of hereditary variables.
    real(wp), intent(in) :: mean(:, :, :), without(:, :)
    real(wp) :: felt(size(without, 1), size(band%squares))
    integer :: m, q

    m = size(band%squares)
    self%serves = band%only_modes() .and. m <= size(without, 1) .and. size(swings) > 0
    if (.not. self%serves) return
    self%squares = band%squares
    self%rates = band%rates
    self%seen = band%seen(:, swings)
    self%pushed = band%pushed(:, swings)
    if (allocated(self%carried)) deallocate (self%carried, self%own)
    allocate (self%carried(m, m, 0:size(mean, 3)), self%own(size(swings), m, 0:size(mean, 3)))
    do q = 0, size(mean, 3)
      if (q == 0) felt = -matmul(without, transpose(band%seen))
      if (q > 0) felt = matmul(mean(:, :, q), transpose(band%seen))
      self%carried(:, :, q) = matmul(band%pushed(:, others), felt(others, :))
      self%own(:, :, q) = felt(swings, :)
    end do
  end subroutine prepare

  !> H' at many s, J_A. c^T E^-1 b_A there, and the product of the determinants.
  pure subroutine remaining(self, s, kept, soft_re, soft_im, own_re, own_im, factor)
    class(modal_rest), intent(in) :: self
    !> Shape (p), and what each kernel leaves there, shape (p, groups).
    complex(wp), intent(in) :: s(:), kept(:, :)
    !> Shape (p, n_swings, n_swings).
    real(wp), intent(out), dimension(:, :, :) :: soft_re, soft_im, own_re, own_im
    !> 0 where some order wants rows exchanged.
    complex(wp), intent(out) :: factor
    real(wp) :: f(n_lanes, size(kept, 2)), g(n_lanes, size(kept, 2)), u(n_lanes), v(n_lanes)
    real(wp), dimension(n_lanes, size(self%squares), size(self%seen, 2)) :: x, y
    real(wp), dimension(n_lanes, size(self%seen, 2), size(self%seen, 2)) :: total_re, total_im
    complex(wp) :: quotient(n_lanes)
    integer :: first, i, n
    logical :: made

    factor = (1.0_wp, 0.0_wp)
    do first = 1, size(s), n_lanes
      n = min(n_lanes, size(s) - first + 1)
      ! Lanes without an order repeat the first one.
      u = real(s(first))
      v = aimag(s(first))
      u(:n) = real(s(first:first + n - 1))
      v(:n) = aimag(s(first:first + n - 1))
      do i = 1, n_lanes
        f(i, :) = real(kept(first + merge(i - 1, 0, i <= n), :))
        g(i, :) = aimag(kept(first + merge(i - 1, 0, i <= n), :))
      end do
      call solve(size(x, 2), size(x, 3), size(f, 2), self%squares, self%rates, self%carried, &
                 self%pushed, u, v, f, g, x, y, quotient, made)
      if (.not. made) factor = (0.0_wp, 0.0_wp)
      if (.not. made) return
      factor = factor*product(quotient(:n))
      call see(size(x, 2), size(x, 3), self%seen, x, y, total_re, total_im)
      soft_re(first:first + n - 1, :, :) = total_re(:n, :, :)
      soft_im(first:first + n - 1, :, :) = total_im(:n, :, :)
      call resist(size(x, 2), size(x, 3), size(f, 2), self%own, f, g, x, y, total_re, total_im)
      own_re(first:first + n - 1, :, :) = total_re(:n, :, :)
      own_im(first:first + n - 1, :, :) = total_im(:n, :, :)
    end do
  end subroutine remaining

  !> E^-1 b_A and det E/det R^-1 at some s.
  pure subroutine solve(n, m, n_groups, squares, rates, carried, pushed, s_re, s_im, f, g, x, y, &
                        quotient, made)
    integer, intent(in) :: n, m, n_groups
    real(wp), intent(in) :: squares(n), rates(n), carried(n, n, 0:n_groups), pushed(n, m)
    !> s, and what each kernel leaves there.
    real(wp), intent(in), dimension(n_lanes) :: s_re, s_im
    real(wp), intent(in), dimension(n_lanes, n_groups) :: f, g
    real(wp), intent(out), dimension(n_lanes, n, m) :: x, y
    complex(wp), intent(out) :: quotient(n_lanes)
    logical, intent(out) :: made
    real(wp), dimension(n_lanes, n, n) :: re, im
    real(wp), dimension(n_lanes) :: free_re, free_im
    integer :: b, i, j, q

    quotient = (1.0_wp, 0.0_wp)
    do j = 1, n
      do i = 1, n
        re(:, i, j) = carried(i, j, 0)
        im(:, i, j) = 0.0_wp
        do q = 1, n_groups
          re(:, i, j) = re(:, i, j) + carried(i, j, q)*f(:, q)
          im(:, i, j) = im(:, i, j) + carried(i, j, q)*g(:, q)
        end do
      end do
      free_re = squares(j) + (rates(j) + s_re)*s_re - s_im*s_im
      free_im = (rates(j) + 2.0_wp*s_re)*s_im
      re(:, j, j) = re(:, j, j) + free_re
      im(:, j, j) = im(:, j, j) + free_im
      quotient = quotient*cmplx(free_re, free_im, wp)
    end do
    do b = 1, m
      do i = 1, n
        x(:, i, b) = pushed(i, b)
      end do
    end do
    y = 0.0_wp
    made = .not. any(.not. abs(real(quotient)) + abs(aimag(quotient)) > 0.0_wp)
    if (made) call eliminate(n, m, re, im, x, y, quotient, made)
  end subroutine solve

  !> c_A^T (x + i y).
  pure subroutine see(n, m, seen, x, y, total_re, total_im)
    integer, intent(in) :: n, m
    real(wp), intent(in) :: seen(n, m)
    real(wp), intent(in), dimension(n_lanes, n, m) :: x, y
    real(wp), intent(out), dimension(n_lanes, m, m) :: total_re, total_im
    integer :: a, b, i

    do b = 1, m
      do a = 1, m
        total_re(:, a, b) = seen(1, a)*x(:, 1, b)
        total_im(:, a, b) = seen(1, a)*y(:, 1, b)
        do i = 2, n
          total_re(:, a, b) = total_re(:, a, b) + seen(i, a)*x(:, i, b)
          total_im(:, a, b) = total_im(:, a, b) + seen(i, a)*y(:, i, b)
        end do
      end do
    end do
  end subroutine see

  !> J_A. c^T (x + i y).
  pure subroutine resist(n, m, n_groups, own, f, g, x, y, total_re, total_im)
    integer, intent(in) :: n, m, n_groups
    real(wp), intent(in) :: own(m, n, 0:n_groups)
    real(wp), intent(in), dimension(n_lanes, n_groups) :: f, g
    real(wp), intent(in), dimension(n_lanes, n, m) :: x, y
    real(wp), intent(out), dimension(n_lanes, m, m) :: total_re, total_im
    real(wp), dimension(n_lanes) :: u, v
    integer :: a, b, i, q

    total_re = 0.0_wp
    total_im = 0.0_wp
    do i = 1, n
      do a = 1, m
        u = own(a, i, 0)
        v = 0.0_wp
        do q = 1, n_groups
          u = u + own(a, i, q)*f(:, q)
          v = v + own(a, i, q)*g(:, q)
        end do
        do b = 1, m
          total_re(:, a, b) = total_re(:, a, b) + (u*x(:, i, b) - v*y(:, i, b))
          total_im(:, a, b) = total_im(:, a, b) + (u*y(:, i, b) + v*x(:, i, b))
        end do
      end do
    end do
  end subroutine resist

  !> Solve for the columns x + i y, and divide the determinants by `quotient`.
  pure subroutine eliminate(n, m, re, im, x, y, quotient, made)
    integer, intent(in) :: n, m
    real(wp), intent(inout), dimension(n_lanes, n, n) :: re, im
    real(wp), intent(inout), dimension(n_lanes, n, m) :: x, y
    complex(wp), intent(inout) :: quotient(n_lanes)
    !> Not where rows had to be exchanged.
    logical, intent(out) :: made
    complex(wp) :: determinant(n_lanes)
    real(wp), dimension(n_lanes) :: u, v, f, g, below
    integer :: i, j, k

    determinant = (1.0_wp, 0.0_wp)
    made = .false.
    do j = 1, n
      below = 0.0_wp
      do i = j + 1, n
        below = max(below, abs(re(:, i, j)), abs(im(:, i, j)))
      end do
      u = re(:, j, j)
      v = im(:, j, j)
      if (any(.not. abs(u) + abs(v) > weak*below)) return
      determinant = determinant*cmplx(u, v, wp)
      f = 1.0_wp/(u*u + v*v)
      u = u*f
      v = -v*f
      do k = j + 1, n
        call multiply(u, v, re(1, j, k), im(1, j, k))
      end do
      do k = 1, m
        call multiply(u, v, x(1, j, k), y(1, j, k))
      end do
      do i = j + 1, n
        f = re(:, i, j)
        g = im(:, i, j)
        do k = j + 1, n
          call subtract(f, g, re(1, j, k), im(1, j, k), re(1, i, k), im(1, i, k))
        end do
        do k = 1, m
          call subtract(f, g, x(1, j, k), y(1, j, k), x(1, i, k), y(1, i, k))
        end do
      end do
    end do
    do k = 1, m
      do j = n, 2, -1
        do i = 1, j - 1
          call subtract(re(1, i, j), im(1, i, j), x(1, j, k), y(1, j, k), x(1, i, k), y(1, i, k))
        end do
      end do
    end do
    quotient = determinant/quotient
    made = .true.
  end subroutine eliminate

  pure subroutine multiply(u, v, re, im)
    real(wp), intent(in), dimension(n_lanes) :: u, v
    real(wp), intent(inout), dimension(n_lanes) :: re, im
    real(wp) :: old(n_lanes)
    old = re
    re = u*old - v*im
    im = u*im + v*old
  end subroutine multiply

  pure subroutine subtract(f, g, x, y, re, im)
    real(wp), intent(in), dimension(n_lanes) :: f, g, x, y
    real(wp), intent(inout), dimension(n_lanes) :: re, im
    re = re - (f*x - g*y)
    im = im - (f*y + g*x)
  end subroutine subtract

end module viscovib_condensed_modes
