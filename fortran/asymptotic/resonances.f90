!> Enumeration of the conditions of resonance up to third order among natural frequencies w_j
!! and load frequencies p_k.
!!
!! In the method a product of one to three generators, each with its frequency or the
!! opposite, resonates with mode j if sum = w_j. Conditions that hold for all frequencies
!! (w_j = w_j + w_k - w_k) are omitted. A change of sign or of sides gives the same
!! condition. The results are integer vectors c with sum_i c_i f_i = 0 whose first entry other
!! than 0 is positive. They contain at least one mode, and
!! |c_1| + |c_2| + ... = 2 (loads near modes, modes near each other), 3 or 4; as a condition
!! on a mode, of order 1, 2 or 3.
module viscovib_resonances
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: list_resonances

  integer, parameter :: highest_order = 3

contains

  !> Order n - 1: n frequencies, with repetitions. A single frequency gives no condition.
  subroutine list_resonances(natural, drives, coefficients, orders, divisors, n)
    !> Circular frequencies, all > 0.
    real(wp), intent(in) :: natural(:), drives(:)
    !> Shape (n_natural + n_drives, room): c; columns beyond n are 0.
    integer, intent(out) :: coefficients(:, :), orders(:)
    !> |sum c_i f_i|/max(f_i with c_i /= 0).
    real(wp), intent(out) :: divisors(:)
    !> Number of conditions, including those that do not fit into the arrays.
    integer, intent(out) :: n
    real(wp) :: frequencies(size(natural) + size(drives))
    integer :: c(size(natural) + size(drives)), total

    frequencies = [natural, drives]
    coefficients = 0
    orders = 0
    divisors = 0.0_wp
    n = 0
    c = 0
    do total = 2, highest_order + 1
      call place(1, total)
    end do

  contains

    !> Distribute the rest of the sum of moduli over the entries from i on.
    recursive subroutine place(i, left)
      integer, intent(in) :: i, left
      integer :: value
      if (i > size(c)) then
        if (left == 0) call keep()
        return
      end if
      do value = -left, left
        ! The first entry other than 0 is positive.
        if (value < 0 .and. all(c(:i - 1) == 0)) cycle
        c(i) = value
        call place(i + 1, left - abs(value))
      end do
      c(i) = 0
    end subroutine place

    subroutine keep()
      logical :: used(size(c))
      used = c /= 0
      if (.not. any(used(:size(natural)))) return
      ! A sum of entries of one sign is never 0; multiples of a condition are omitted.
      if (all(c >= 0) .or. all(modulo(c, 2) == 0)) return
      n = n + 1
      if (n > size(orders)) return
      coefficients(:, n) = c
      orders(n) = total - 1
      divisors(n) = abs(sum(c*frequencies))/maxval(frequencies, mask=used)
    end subroutine keep

  end subroutine list_resonances

end module viscovib_resonances
