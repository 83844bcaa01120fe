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
    complex(wp) :: compliance(size(without, 1), size(without, 1))
    complex(wp) :: soft(size(without, 1), size(swings)), own(size(swings), size(swings))
    real(wp), dimension(-reach:reach, size(swings), size(swings), size(kept, 2)) :: c, s
    real(wp), dimension(p, size(kept, 2)) :: kept_re, kept_im
    integer :: a, b, l, n, q, middle

    n = size(swings)
    middle = (size(local, 3) + 1)/2
    do q = 1, size(kept, 2)
      do b = 1, n
        do a = 1, n
          associate (wave => local(swings(a), swings(b), middle - reach:middle + reach, q))
            c(:, a, b, q) = real(wave)
            s(:, a, b, q) = aimag(wave)
          end associate
        end do
      end do
    end do
    kept_re = real(kept)
    kept_im = aimag(kept)
    factor = (1.0_wp, 0.0_wp)
    re(:n*p, :n*p) = 0.0_wp
    im(:n*p, :n*p) = 0.0_wp
    do l = 1, p
      mean = -without
      do q = 1, size(kept, 2)
        mean = mean + kept(l, q)*local(:, :, middle, q)
      end do
      compliance = h(l, :, :)
      call remaining(compliance, mean, swings, others, soft, part)
      factor = factor*part
      if (.not. abs(factor) > 0.0_wp) return
      do b = 1, n
        call fill_column(p, reach, n, l, size(kept, 2), kept_re, kept_im, c, s, soft(swings, b), &
                         re(:n*p, (l - 1)*n + b), im(:n*p, (l - 1)*n + b))
      end do
      own = matmul(mean(swings, :), soft)
      do b = 1, n
        own(b, b) = own(b, b) + 1.0_wp
      end do
      re((l - 1)*n + 1:l*n, (l - 1)*n + 1:l*n) = real(own)
      im((l - 1)*n + 1:l*n, (l - 1)*n + 1:l*n) = aimag(own)
    end do
  end subroutine fill_waves

  !> One column of J H', of order l, but for the rows of order l.
  pure subroutine fill_column(p, reach, n, l, n_groups, kept_re, kept_im, c, s, soft, re, im)
    integer, intent(in) :: p, reach, n, l, n_groups
    !> Real and imaginary parts of what is kept and of the waves of J.
    real(wp), intent(in) :: kept_re(p, n_groups), kept_im(p, n_groups)
    real(wp), intent(in), dimension(-reach:reach, n, n, n_groups) :: c, s
    !> A column of H'.
    complex(wp), intent(in) :: soft(n)
    real(wp), intent(inout) :: re(n, p), im(n, p)
    real(wp), dimension(-reach:reach) :: x, y
    real(wp) :: f, g
    integer :: a, b, i, q

    do q = 1, n_groups
      do a = 1, n
        x = 0.0_wp
        y = 0.0_wp
        do b = 1, n
          f = real(soft(b))
          g = aimag(soft(b))
          x = x + (f*c(:, a, b, q) - g*s(:, a, b, q))
          y = y + (f*s(:, a, b, q) + g*c(:, a, b, q))
        end do
        do i = max(1, l - reach), min(p, l + reach)
          re(a, i) = re(a, i) + (kept_re(i, q)*x(i - l) - kept_im(i, q)*y(i - l))
          im(a, i) = im(a, i) + (kept_re(i, q)*y(i - l) + kept_im(i, q)*x(i - l))
        end do
      end do
    end do
  end subroutine fill_column

  !> H' of one order and det S.
  pure subroutine remaining(h, mean, swings, others, soft, determinant)
    complex(wp), intent(in) :: h(:, :), mean(:, :)
    integer, intent(in) :: swings(:), others(:)
    complex(wp), intent(out) :: soft(:, :), determinant
    complex(wp) :: solved(size(others), size(h, 1))
    complex(wp), dimension(size(h, 1), size(others)) :: by_others
    integer :: a, b, k, n

    n = size(others)
    by_others = h(:, others)
    soft = h(:, swings)
    solved = (0.0_wp, 0.0_wp)
    do k = 1, size(h, 1)
      do b = 1, n
        solved(:, b) = solved(:, b) + mean(others, k)*by_others(k, b)
      end do
      do b = 1, size(swings)
        solved(:, n + b) = solved(:, n + b) + mean(others, k)*soft(k, b)
      end do
    end do
    do a = 1, n
      solved(a, a) = solved(a, a) + 1.0_wp
    end do
    call eliminate(solved, determinant)
    do b = 1, size(swings)
      do a = 1, n
        soft(:, b) = soft(:, b) - by_others(:, a)*solved(a, n + b)
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
