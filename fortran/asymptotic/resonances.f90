!> List of the conditions of resonance up to third order among natural frequencies w_j and load
!! frequencies p_k.
!!
!! A product of one to three generators, each with its frequency or the opposite, resonates with
!! mode j if the sum of frequencies equals w_j. Identities for all frequencies (w_j = w_j + w_k -
!! w_k) are not conditions. Changes of sign or of the side of the equation give the same condition.
!! The conditions are integer vectors c with sum_i c_i f_i = 0, whose first nonzero entry is
!! positive, with at least one mode and |c_1| + |c_2| + ... = 2 (loads near modes, modes near each
!! other), 3 or 4; as a condition on a mode, of order 1, 2 or 3.
module viscovib_resonances
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: list_resonances

  integer, parameter :: highest_order = 3

contains

  !> Order n - 1: n frequencies, with repetitions. A single frequency gives no condition.
  subroutine list_resonances(natural, drives, coefficients, orders, divisors)
    !> Circular frequencies, all > 0.
    real(wp), intent(in) :: natural(:), drives(:)
    !> c, shape (n_natural + n_drives, n), and the order of each.
    integer, allocatable, intent(out) :: coefficients(:, :), orders(:)
    !> |sum c_i f_i|/max(f_i with c_i /= 0), shape (n).
    real(wp), allocatable, intent(out) :: divisors(:)
    real(wp) :: frequencies(size(natural) + size(drives))
    integer :: c(size(natural) + size(drives)), n, total
    logical :: counted

    frequencies = [natural, drives]
    counted = .false.
    call enumerate()
    allocate (coefficients(size(c), n), orders(n), divisors(n))
    counted = .true.
    call enumerate()

  contains

    subroutine enumerate()
      n = 0
      c = 0
      do total = 2, highest_order + 1
        call place(1, total)
      end do
    end subroutine enumerate

    !> Distribute the remaining sum of moduli over the entries from i on.
    recursive subroutine place(i, left)
      integer, intent(in) :: i, left
      integer :: value
      if (i > size(c)) then
        if (left == 0) call keep()
        return
      end if
      do value = -left, left
        ! The first nonzero entry is positive.
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
      if (.not. counted) return
      coefficients(:, n) = c
      orders(n) = total - 1
      divisors(n) = abs(sum(c*frequencies))/maxval(frequencies, mask=used)
    end subroutine keep

  end subroutine list_resonances

end module viscovib_resonances
