!> Expand powers of spring deflections in products of the coordinates.
module viscovib_spring_products
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: max_degree, polynomial_parameters
  use viscovib_turning_body, only: body_spring
  implicit none
  private

  public :: add_products, n_products

contains

  !> Number of products of n coordinates with this total power.
  pure real(wp) function n_products(n, power)
    integer, intent(in) :: n, power
    n_products = gamma(real(n + power, wp))/(gamma(power + 1.0_wp)*gamma(real(n, wp)))
  end function n_products

  !> Add sum_j c_j e_j (e_j . u)^p for each kernel.
  subroutine add_products(springs, rows, n_kernels, p)
    type(body_spring), intent(in) :: springs(:)
    !> e_j, shape (size(springs), n).
    real(wp), intent(in) :: rows(:, :)
    integer, intent(in) :: n_kernels
    !> Receives all monomials.
    type(polynomial_parameters), intent(inout) :: p
    integer :: power, kernel, on, j, n, m, powers(size(rows, 2))
    real(wp) :: parts(size(springs)), total
    logical :: bent(size(springs)), felt(size(rows, 2))

    n = size(rows, 2)
    m = 0
    allocate (p%coefficient(0), p%on(0), p%monomial_kernel(0), p%powers(n, 0))
    do kernel = 0, n_kernels
      do power = 2, max_degree
        do j = 1, size(springs)
          bent(j) = springs(j)%kernel == kernel .and. size(springs(j)%coefficient) >= power - 1
          if (bent(j)) bent(j) = abs(springs(j)%coefficient(power - 1)) > 0.0_wp
        end do
        if (.not. any(bent)) cycle
        felt = any(abs(rows) > 0.0_wp .and. spread(bent, 2, n), 1)
        powers = 0
        powers(n) = power
        do
          if (all(felt .or. powers == 0)) call add_product()
          if (powers(1) == power) exit
          call next_powers(powers)
        end do
      end do
    end do
    call p%resize_monomials(m)

  contains

    !> Add one product of all springs with one kernel to every equation.
    subroutine add_product()
      parts = 0.0_wp
      do j = 1, size(springs)
        if (bent(j)) parts(j) = springs(j)%coefficient(power - 1)*ways(powers) &
                                *product(rows(j, :)**powers)
      end do
      do on = 1, n
        total = sum(parts*rows(:, on))
        if (.not. abs(total) > 0.0_wp) cycle
        if (m == size(p%on)) call p%resize_monomials(2*m + 64)
        m = m + 1
        p%coefficient(m) = total
        p%on(m) = on
        p%monomial_kernel(m) = kernel
        p%powers(:, m) = powers
      end do
    end subroutine add_product

  end subroutine add_products

  !> Next exponents with the same sum: from all in the last to all in the first.
  pure subroutine next_powers(powers)
    integer, intent(inout) :: powers(:)
    integer :: i, last, n

    n = size(powers)
    i = n
    do while (powers(i) == 0)
      i = i - 1
    end do
    last = powers(i)
    powers(i) = 0
    powers(i - 1) = powers(i - 1) + 1
    powers(n) = last - 1
  end subroutine next_powers

  !> Multinomial coefficient of a product in the power of a sum.
  pure real(wp) function ways(powers)
    integer, intent(in) :: powers(:)
    ways = gamma(sum(powers) + 1.0_wp)/product(gamma(powers + 1.0_wp))
  end function ways

end module viscovib_spring_products
