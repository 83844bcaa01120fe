!> Hill's determinant of a condensed structure in those deflections only whose stiffness swings.
!!
!! Of the local stiffness J the waves, J_kl with k /= l, have rows and columns in some deflections
!! A alone; in the others, P, memory is linear. With forces G = J Y in place of deflections,
!! det(I + H J) = det(I + J H), and the rows P of I + J H stay within one order,
!!
!!   S_k G_P = -T_k G_A,   S_k = I + J_P. H_.P,   T_k = J_P. H_.A   at s_k,
!!
!! which leaves det(I + H J) = prod_k det S_k det(I + J H'), over A alone, with the compliance
!! H' = H_.A - H_.P S_k^-1 T_k of the rest and its linear memory together.
module viscovib_condensed_waves
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: fill_waves

contains

  !> I + J H' over the deflections that swing.
  pure subroutine fill_waves(p, reach, swings, others, h, kept, local, without, re, im, factor)
    !> Orders, and how far J reaches.
    integer, intent(in) :: p, reach
    !> A and P.
    integer, intent(in) :: swings(:), others(:)
    !> H, what each kernel leaves, J by the difference of orders, and what it is less of
    !! hereditary variables: as in `viscovib_condensed_hill`.
    complex(wp), intent(in) :: h(:, :, :), kept(:, :), local(:, :, :, :)
    real(wp), intent(in) :: without(:, :)
    real(wp), intent(inout) :: re(:, :), im(:, :)
    !> prod_k det S_k, 0 where one cannot be solved.
    complex(wp), intent(out) :: factor
    complex(wp) :: mean(size(without, 1), size(without, 1)), part
    complex(wp) :: soft(size(without, 1), size(swings))
    complex(wp), dimension(size(swings), size(swings)) :: wave, block
    complex(wp) :: waves(size(swings), size(swings), -reach:reach, size(kept, 2))
    integer :: a, b, i, l, n, q, middle

    n = size(swings)
    middle = (size(local, 3) + 1)/2
    do b = 1, n
      do a = 1, n
        waves(a, b, :, :) = local(swings(a), swings(b), middle - reach:middle + reach, :)
      end do
    end do
    factor = (1.0_wp, 0.0_wp)
    re(:n*p, :n*p) = 0.0_wp
    im(:n*p, :n*p) = 0.0_wp
    do l = 1, p
      mean = -without
      do q = 1, size(kept, 2)
        mean = mean + kept(l, q)*local(:, :, middle, q)
      end do
      call remaining(h(l, :, :), mean, swings, others, soft, part)
      factor = factor*part
      if (.not. abs(factor) > 0.0_wp) return
      do i = max(1, l - reach), min(p, l + reach)
        wave = mean(swings, swings)
        if (i /= l) wave = kept(i, 1)*waves(:, :, i - l, 1)
        do q = 2, merge(0, size(kept, 2), i == l)
          wave = wave + kept(i, q)*waves(:, :, i - l, q)
        end do
        do b = 1, n
          block(:, b) = wave(:, 1)*soft(swings(1), b)
          do a = 2, n
            block(:, b) = block(:, b) + wave(:, a)*soft(swings(a), b)
          end do
        end do
        if (i == l) call add_own(mean, swings, others, soft, block)
        re((i - 1)*n + 1:i*n, (l - 1)*n + 1:l*n) = real(block)
        im((i - 1)*n + 1:i*n, (l - 1)*n + 1:l*n) = aimag(block)
      end do
    end do
  end subroutine fill_waves

  !> What stands in A within one order beside J_AA H'_A.: I + J_AP H'_P.
  pure subroutine add_own(mean, swings, others, soft, block)
    complex(wp), intent(in) :: mean(:, :), soft(:, :)
    integer, intent(in) :: swings(:), others(:)
    complex(wp), intent(inout) :: block(:, :)
    integer :: a, b

    do b = 1, size(swings)
      do a = 1, size(others)
        block(:, b) = block(:, b) + mean(swings, others(a))*soft(others(a), b)
      end do
      block(b, b) = block(b, b) + 1.0_wp
    end do
  end subroutine add_own

  !> H' of one order and det S.
  pure subroutine remaining(h, mean, swings, others, soft, determinant)
    complex(wp), intent(in) :: h(:, :), mean(:, :)
    integer, intent(in) :: swings(:), others(:)
    complex(wp), intent(out) :: soft(:, :), determinant
    complex(wp) :: solved(size(others), size(h, 1))
    integer :: a, b, n

    n = size(others)
    do a = 1, n
      do b = 1, n
        solved(a, b) = sum(mean(others(a), :)*h(:, others(b)))
      end do
      solved(a, a) = solved(a, a) + 1.0_wp
      do b = 1, size(swings)
        solved(a, n + b) = sum(mean(others(a), :)*h(:, swings(b)))
      end do
    end do
    call eliminate(solved, determinant)
    do b = 1, size(swings)
      soft(:, b) = h(:, swings(b))
      do a = 1, n
        soft(:, b) = soft(:, b) - h(:, others(a))*solved(a, n + b)
      end do
    end do
  end subroutine remaining

  !> Solve the square on the left for the columns behind it, in place; its determinant.
  pure subroutine eliminate(matrix, determinant)
    complex(wp), intent(inout) :: matrix(:, :)
    complex(wp), intent(out) :: determinant
    complex(wp) :: row(size(matrix, 2))
    integer :: i, j, n

    n = size(matrix, 1)
    determinant = (1.0_wp, 0.0_wp)
    do j = 1, n
      i = j - 1 + maxloc(abs(real(matrix(j:, j))) + abs(aimag(matrix(j:, j))), 1)
      if (i /= j) then
        row = matrix(i, :)
        matrix(i, :) = matrix(j, :)
        matrix(j, :) = row
        determinant = -determinant
      end if
      determinant = determinant*matrix(j, j)
      if (.not. abs(determinant) > 0.0_wp) return
      matrix(j, j + 1:) = matrix(j, j + 1:)/matrix(j, j)
      do i = 1, n
        if (i /= j) matrix(i, j + 1:) = matrix(i, j + 1:) - matrix(i, j)*matrix(j, j + 1:)
      end do
    end do
  end subroutine eliminate

end module viscovib_condensed_waves
