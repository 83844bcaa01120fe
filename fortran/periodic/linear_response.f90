! Optimize: -O3
!> Linear steady response, and the dynamic compliance that the nonlinear
!! methods start from.
module viscovib_linear_response
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_counters, only: count_unknowns, count_up, counted_loads, counting
  use viscovib_dense, only: invert
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_overflow, outcome_singular
  use viscovib_response, only: response_type
  implicit none
  private

  public :: linear_response, compliance_table, frequencies_together

  !> Frequencies treated together: enough to fill vector calls of the kernel transforms, few enough
  !! to stay in cache; for many coordinates fewer, with this number of entries, but at least a few.
  integer, parameter :: chunk_size = 256, most_entries = 4000000, fewest = 8

contains

  !> Frequencies treated together, of which all compliances are stored.
  pure integer function frequencies_together(n_dof, n_orders) result(n)
    integer, intent(in) :: n_dof, n_orders
    n = max(fewest, min(chunk_size, most_entries/(n_dof**2*max(n_orders, 1))))
  end function frequencies_together

  !> Compliance D(k nu)^(-1) for every order k and frequency nu.
  subroutine compliance_table(system, orders, nu, fraction, compliance, singular, by_rate)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: orders(:)
    !> Shape (n).
    real(wp), intent(in) :: nu(:)
    !> Memory factors 1 - Rhat, shape (n, n_memory, size(orders)).
    complex(wp), intent(out), contiguous :: fraction(:, :, :)
    !> Shape (n_dof, n_dof, n, size(orders)).
    complex(wp), intent(out) :: compliance(:, :, :, :)
    !> True if an order has a singular stiffness, shape (n).
    logical, intent(out) :: singular(:)
    !> From `slopes_by_rate`, if D includes these terms.
    real(wp), intent(in), optional :: by_rate(:, :)
    complex(wp) :: stiffness(system%n_dof(), system%n_dof(), size(nu))
    logical :: bad
    integer :: i, k

    singular = .false.
    do k = 1, size(orders)
      call system%retained(orders(k)*nu, fraction(:, :, k))
      call system%dynamic_stiffness(orders(k)*nu, nu, fraction(:, :, k), stiffness)
      if (present(by_rate)) call add_rates(system, by_rate, orders(k)*nu, fraction(:, :, k), &
                                           stiffness)
      do i = 1, size(nu)
        call invert(stiffness(:, :, i), compliance(:, :, i, k), bad)
        singular(i) = singular(i) .or. bad
      end do
    end do
  end subroutine compliance_table

  !> Derivatives of the hereditary variables by the rates at zero, shape (n_memory, n_dof). Without
  !! a kernel these terms are part of the damping, and 0 here. With a kernel they are part of the
  !! law, since memory acts on them.
  function slopes_by_rate(system) result(by_rate)
    class(oscillator_type), intent(in) :: system
    real(wp) :: by_rate(system%n_memory(), system%n_dof())
    real(wp), dimension(1, system%n_dof() + system%n_rates()) :: rest
    real(wp) :: slopes(1, system%n_memory(), system%n_dof() + system%n_rates())
    integer :: i

    by_rate = 0.0_wp
    if (system%n_rates() == 0) return
    rest = 0.0_wp
    slopes = 0.0_wp
    call system%deflection_slopes(rest, slopes)
    do i = 1, system%n_rates()
      by_rate(:, system%rates(i)) = slopes(1, :, system%n_dof() + i)
    end do
  end function slopes_by_rate

  !> Add sum_j B(:,j) C_j (1 - Rhat_j(mu)) i mu, C_j the derivatives of variable j by the rates.
  pure subroutine add_rates(system, by_rate, mu, fraction, stiffness)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: by_rate(:, :), mu(:)
    complex(wp), intent(in) :: fraction(:, :)
    complex(wp), intent(inout) :: stiffness(:, :, :)
    integer :: b, j, k

    do k = 1, size(mu)
      do b = 1, size(by_rate, 2)
        do j = 1, size(by_rate, 1)
          if (.not. abs(by_rate(j, b)) > 0.0_wp) cycle
          stiffness(:, b, k) = stiffness(:, b, k) + system%spread(:, j) &
                               *(by_rate(j, b)*(0.0_wp, 1.0_wp)*mu(k)*fraction(k, j))
        end do
      end do
    end do
  end subroutine add_rates

  !> X_k = D(k nu)^(-1) P_k for the orders of the load, the only orders in the response of a linear
  !! system. D includes the terms linear in rates of laws with a kernel.
  subroutine linear_response(system, load, nu, response)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    complex(wp), allocatable :: fraction(:, :, :), compliance(:, :, :, :)
    complex(wp) :: p(system%n_dof())
    logical :: singular(chunk_size)
    integer :: first, n, b, i, k, n_orders

    n_orders = size(load%orders)
    call response%allocate_for(nu, load%orders, system%n_dof(), 0)
    do first = 1, size(nu), frequencies_together(system%n_dof(), n_orders)
      n = min(frequencies_together(system%n_dof(), n_orders), size(nu) - first + 1)
      allocate (fraction(n, system%n_memory(), n_orders), &
                compliance(system%n_dof(), system%n_dof(), n, n_orders))
      if (counting) call count_unknowns(load%orders, system%n_dof(), n)
      if (counting) call count_up(counted_loads, n*n_orders)
      call compliance_table(system, load%orders, nu(first:first + n - 1), fraction, compliance, &
                            singular(:n), slopes_by_rate(system))
      do i = 1, n
        do k = 1, n_orders
          p = load%coefficient(system, load%orders(k), nu(first + i - 1))
          do b = 1, size(p)
            response%coefficients(k, :, first + i - 1) = &
              response%coefficients(k, :, first + i - 1) + compliance(:, b, i, k)*p(b)
          end do
        end do
        if (singular(i)) then
          call response%discard(first + i - 1, outcome_singular)
        else if (.not. all(finite(response%coefficients(:, :, first + i - 1)))) then
          call response%discard(first + i - 1, outcome_overflow)
        end if
      end do
      deallocate (fraction, compliance)
    end do
    call response%add_base_motion(system, load)
  end subroutine linear_response

  elemental logical function finite(z)
    complex(wp), intent(in) :: z
    finite = ieee_is_finite(real(z)) .and. ieee_is_finite(aimag(z))
  end function finite

end module viscovib_linear_response
