!> Growth of small perturbations in a step of a repeated length, with linear derivatives.
!!
!! Perturbations Y of n coordinates obey Y'' = A_q(t) Y + A_v(t) Y' (viscovib_nearby_motion). If
!! only a few local laws vary, the slopes at node i of a step are those of a base and a low-rank
!! sum,
!!
!!   A_q(t_i) = B_q + sum_k u_k w_k^T (k of node i),  A_v(t_i) likewise,
!!
!! so that with X = Y'' at the nodes, G the collocation matrix of the base and e_i(u) the vector
!! that is u at node i and 0 elsewhere,
!!
!!   G X = F s + sum_k e_i(u_k) z_k,  z_k = w_k^T Y or w_k^T Y' at node i,
!!
!! with the perturbations s before the step. G^-1 F is computed once for all steps of one length.
!! Each step then requires only the solution of a small system for z (J. Sherman,
!! W. J. Morrison, Ann. Math. Stat. 21, 1950; M. A. Woodbury). A step then takes some 20 n^3
!! operations, instead of 600 with its own G.
module viscovib_base_step
  use viscovib_dense, only: factorize, solve_columns
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: base_step

  !> Rounding error of derivatives, relative to their terms.
  real(wp), parameter :: rounding = 32.0_wp*epsilon(1.0_wp)
  !> Largest change of the step due to a product, so that no digits are lost in the small system.
  real(wp), parameter :: most = 4.0_wp
  !> Largest number of products of a node is n divided by this; with more, its own G is as fast.
  integer, parameter :: part = 8

  type :: base_step
    real(wp) :: h = 0.0_wp
    !> Slopes of the base, shape (n, n), and factors of G.
    real(wp), allocatable, private :: by_q(:, :), by_v(:, :), g(:, :)
    integer, allocatable, private :: pivots(:)
    !> X for unit perturbations before the step, and those after it, coordinates before velocities.
    real(wp), allocatable, private :: x(:, :), map(:, :)
  contains
    procedure :: make
    procedure :: advance
  end type base_step

  !> Products u w^T of nodes, of slopes by coordinates or by velocities.
  type :: products
    integer :: n = 0
    real(wp), allocatable :: u(:, :), w(:, :)
    integer, allocatable :: node(:)
    logical, allocatable :: by_rate(:)
  end type products

contains

  !> Set up the base from slopes, shape (n, n), for steps h with nodes c, weights b_q and b, and
  !! sums a_q and a.
  subroutine make(self, h, by_q, by_v, c, b_q, b, a_q, a, singular)
    class(base_step), intent(out) :: self
    real(wp), intent(in) :: h, by_q(:, :), by_v(:, :), c(:), b_q(:), b(:), a_q(:, :), a(:, :)
    logical, intent(out) :: singular
    integer :: i, j, n, s

    n = size(by_q, 1)
    s = size(c)
    self%h = h
    self%by_q = by_q
    self%by_v = by_v
    allocate (self%g(s*n, s*n), self%x(s*n, 2*n), self%pivots(s*n))
    do i = 1, s
      do j = 1, s
        self%g((i - 1)*n + 1:i*n, (j - 1)*n + 1:j*n) = -(h**2*a_q(i, j)*by_q + h*a(i, j)*by_v)
      end do
      self%x((i - 1)*n + 1:i*n, :n) = by_q
      self%x((i - 1)*n + 1:i*n, n + 1:) = c(i)*h*by_q + by_v
    end do
    do i = 1, s*n
      self%g(i, i) = self%g(i, i) + 1.0_wp
    end do
    call factorize(s*n, self%g, self%pivots, singular)
    if (singular) then
      self%h = 0.0_wp
      return
    end if
    call solve_columns(s*n, 2*n, self%g, self%pivots, self%x)
    self%map = behind(h, n, b_q, b, self%x)
    do i = 1, n
      self%map(i, i) = self%map(i, i) + 1.0_wp
      self%map(i, n + i) = self%map(i, n + i) + h
      self%map(n + i, n + i) = self%map(n + i, n + i) + 1.0_wp
    end do
  end subroutine make

  !> Contribution of accelerations x at the nodes, block by block, to coordinates and velocities.
  pure function behind(h, n, b_q, b, x) result(added)
    real(wp), intent(in) :: h, b_q(:), b(:), x(:, :)
    integer, intent(in) :: n
    real(wp) :: added(2*n, size(x, 2))
    integer :: i

    added = 0.0_wp
    do i = 1, size(b)
      associate (block => x((i - 1)*n + 1:i*n, :))
        added(:n, :) = added(:n, :) + h**2*b_q(i)*block
        added(n + 1:, :) = added(n + 1:, :) + h*b(i)*block
      end associate
    end do
  end function behind

  !> Advance perturbations q, v, shape (n, m), over a step with slopes by_q, by_v at the nodes,
  !! (n, n, s). `done` is false, without changes, if the slopes are not the base and a few products.
  subroutine advance(self, by_q, by_v, c, b_q, b, a_q, a, q, v, done)
    class(base_step), intent(in) :: self
    real(wp), intent(in) :: by_q(:, :, :), by_v(:, :, :), c(:), b_q(:), b(:), a_q(:, :), a(:, :)
    real(wp), intent(inout) :: q(:, :), v(:, :)
    logical, intent(out) :: done
    type(products) :: found
    real(wp), allocatable :: before(:, :), after(:, :), k(:, :), own(:, :), z(:, :), row(:)
    integer, allocatable :: pivots(:)
    integer :: i, j, n, r
    logical :: singular

    n = size(q, 1)
    call find_products(self, by_q, by_v, found, done)
    if (.not. done) return
    r = found%n
    allocate (before(2*n, size(q, 2)))
    before(:n, :) = q
    before(n + 1:, :) = v
    after = matmul(self%map, before)
    if (r > 0) then
      allocate (k(size(self%x, 1), r), source=0.0_wp)
      do i = 1, r
        k((found%node(i) - 1)*n + 1:found%node(i)*n, i) = found%u(:, i)
      end do
      call solve_columns(size(self%x, 1), r, self%g, self%pivots, k)
      allocate (own(r, r), z(r, 2*n), row(size(self%x, 1)), pivots(r))
      do i = 1, r
        associate (w => found%w(:, i), node => found%node(i))
          do j = 1, size(c)
            row((j - 1)*n + 1:j*n) = w*merge(self%h*a(node, j), self%h**2*a_q(node, j), &
                                             found%by_rate(i))
          end do
          own(i, :) = -matmul(row, k)
          own(i, i) = own(i, i) + 1.0_wp
          z(i, :) = matmul(row, self%x)
          if (found%by_rate(i)) then
            z(i, n + 1:) = z(i, n + 1:) + w
          else
            z(i, :n) = z(i, :n) + w
            z(i, n + 1:) = z(i, n + 1:) + c(node)*self%h*w
          end if
        end associate
      end do
      call factorize(r, own, pivots, singular)
      done = .not. singular
      if (singular) return
      z = matmul(z, before)
      call solve_columns(r, size(z, 2), own, pivots, z)
      after = after + matmul(behind(self%h, n, b_q, b, k), z)
    end if
    q = after(:n, :)
    v = after(n + 1:, :)
  end subroutine advance

  !> The difference of the derivatives from the base, as products: elimination with the largest
  !! diagonal entry, which does not depend on the units of coordinates.
  subroutine find_products(self, by_q, by_v, found, done)
    class(base_step), intent(in) :: self
    real(wp), intent(in) :: by_q(:, :, :), by_v(:, :, :)
    type(products), intent(out) :: found
    logical, intent(out) :: done
    integer :: i, n, s, work

    n = size(by_q, 1)
    s = size(by_q, 3)
    work = max(1, n/part)
    allocate (found%u(n, 2*work*s), found%w(n, 2*work*s), found%node(2*work*s), &
              found%by_rate(2*work*s))
    done = .true.
    do i = 1, s
      call eliminate(by_q(:, :, i), self%by_q, self%h**2, i, .false., work, found, done)
      if (done) call eliminate(by_v(:, :, i), self%by_v, self%h, i, .true., work, found, done)
      if (.not. done) return
    end do
  end subroutine find_products

  subroutine eliminate(here, base, unit, node, by_rate, work, found, done)
    real(wp), intent(in) :: here(:, :), base(:, :), unit
    integer, intent(in) :: node, work
    logical, intent(in) :: by_rate
    type(products), intent(inout) :: found
    logical, intent(out) :: done
    real(wp), allocatable :: left(:, :), terms(:, :)
    integer :: i, j, pivot, taken

    allocate (left(size(here, 1), size(here, 1)), terms(size(here, 1), size(here, 1)))
    left(:, :) = here - base
    terms(:, :) = abs(here) + abs(base)
    do taken = 0, work
      done = all(abs(left) <= rounding*terms)
      if (done .or. taken == work) return
      pivot = 1
      do i = 2, size(left, 1)
        if (abs(left(i, i)) > abs(left(pivot, pivot))) pivot = i
      end do
      if (.not. abs(left(pivot, pivot)) > 0.0_wp) return
      if (unit*abs(left(pivot, pivot)) > most) return
      found%n = found%n + 1
      found%u(:, found%n) = left(:, pivot)
      found%w(:, found%n) = left(pivot, :)/left(pivot, pivot)
      found%node(found%n) = node
      found%by_rate(found%n) = by_rate
      associate (u => found%u(:, found%n), w => found%w(:, found%n))
        do j = 1, size(w)
          left(:, j) = left(:, j) - u*w(j)
          terms(:, j) = terms(:, j) + abs(u*w(j))
        end do
      end associate
    end do
  end subroutine eliminate

end module viscovib_base_step
