! Optimize: -O2 -fvect-cost-model=dynamic
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

  public :: fill_waves, soften

contains

  !> H' at some orders, J_A. [H_.A - H_.P S_k^-1 T_k] there, and prod_k det S_k.
  pure subroutine soften(h, kept, mean, without, swings, others, soft_re, soft_im, own_re, own_im, &
                         factor)
    !> H, what each kernel leaves, the mean of J of each group and what J is less of hereditary
    !! variables: as in `viscovib_condensed_hill`.
    complex(wp), intent(in) :: h(:, :, :), kept(:, :)
    real(wp), intent(in) :: mean(:, :, :), without(:, :)
    !> A and P.
    integer, intent(in) :: swings(:), others(:)
    !> Shape (p, n_swings, n_swings).
    real(wp), intent(out), dimension(:, :, :) :: soft_re, soft_im, own_re, own_im
    !> 0 where one cannot be solved.
    complex(wp), intent(out) :: factor
    complex(wp) :: average(size(without, 1), size(without, 1)), part
    complex(wp) :: soft(size(without, 1), size(swings)), own(size(swings), size(swings))
    integer :: l, q

    factor = (1.0_wp, 0.0_wp)
    do l = 1, size(kept, 1)
      average = -without
      do q = 1, size(kept, 2)
        average = average + kept(l, q)*mean(:, :, q)
      end do
      call remaining(h(l, :, :), average, swings, others, soft, part)
      factor = factor*part
      if (.not. abs(factor) > 0.0_wp) return
      own = matmul(average(swings, :), soft)
      soft_re(l, :, :) = real(soft(swings, :))
      soft_im(l, :, :) = aimag(soft(swings, :))
      own_re(l, :, :) = real(own)
      own_im(l, :, :) = aimag(own)
    end do
  end subroutine soften

  !> I + J H' over the deflections that swing.
  pure subroutine fill_waves(p, reach, rows, swings, kept, local, soft_re, soft_im, own_re, &
                             own_im, re, im)
    !> Orders, how far J reaches, and leading dimension.
    integer, intent(in) :: p, reach, rows
    !> A.
    integer, intent(in) :: swings(:)
    !> What each kernel leaves, and J by the difference of orders.
    complex(wp), intent(in) :: kept(:, :), local(:, :, :, :)
    !> H', and the part of J H' within one order.
    real(wp), intent(in), dimension(:, :, :) :: soft_re, soft_im, own_re, own_im
    real(wp), intent(inout) :: re(rows, size(swings)*p), im(rows, size(swings)*p)
    real(wp), dimension(size(swings), -reach:reach, size(swings), size(kept, 2)) :: c, s
    real(wp), dimension(size(swings), p, size(kept, 2)) :: kept_re, kept_im
    real(wp), dimension(size(swings)) :: f, g
    integer :: a, b, l, n, q, middle

    n = size(swings)
    middle = (size(local, 3) + 1)/2
    do q = 1, size(kept, 2)
      do b = 1, n
        do a = 1, n
          associate (wave => local(swings(a), swings(b), middle - reach:middle + reach, q))
            c(a, :, b, q) = real(wave)
            s(a, :, b, q) = aimag(wave)
          end associate
        end do
      end do
    end do
    do a = 1, n
      kept_re(a, :, :) = real(kept)
      kept_im(a, :, :) = aimag(kept)
    end do
    re(:n*p, :n*p) = 0.0_wp
    im(:n*p, :n*p) = 0.0_wp
    do l = 1, p
      associate (first => max(1, l - reach), last => min(p, l + reach), column => (l - 1)*n)
        do b = 1, n
          f = soft_re(l, :, b)
          g = soft_im(l, :, b)
          do q = 1, size(kept, 2)
            call add_waves(n*(last - first + 1), n, n*(2*reach + 1), kept_re(1, first, q), &
                           kept_im(1, first, q), c(1, first - l, 1, q), s(1, first - l, 1, q), &
                           f, g, re((first - 1)*n + 1, column + b), &
                           im((first - 1)*n + 1, column + b))
          end do
          re(column + 1:column + n, column + b) = own_re(l, :, b)
          im(column + 1:column + n, column + b) = own_im(l, :, b)
          re(column + b, column + b) = re(column + b, column + b) + 1.0_wp
        end do
      end associate
    end do
  end subroutine fill_waves

  !> One column of J H', of one kernel.
  pure subroutine add_waves(n_rows, n, rows, kept_re, kept_im, c, s, f, g, re, im)
    !> Rows of the column that J reaches, columns of J, and its leading dimension.
    integer, intent(in) :: n_rows, n, rows
    !> What is kept at the order of each row.
    real(wp), intent(in) :: kept_re(n_rows), kept_im(n_rows)
    !> J, and a column of H', real and imaginary parts.
    real(wp), intent(in) :: c(rows, n), s(rows, n), f(n), g(n)
    real(wp), intent(inout) :: re(n_rows), im(n_rows)
    real(wp) :: x(n_rows), y(n_rows)
    integer :: b

    x = f(1)*c(:n_rows, 1) - g(1)*s(:n_rows, 1)
    y = f(1)*s(:n_rows, 1) + g(1)*c(:n_rows, 1)
    do b = 2, n
      x = x + (f(b)*c(:n_rows, b) - g(b)*s(:n_rows, b))
      y = y + (f(b)*s(:n_rows, b) + g(b)*c(:n_rows, b))
    end do
    re = re + (kept_re*x - kept_im*y)
    im = im + (kept_re*y + kept_im*x)
  end subroutine add_waves

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
