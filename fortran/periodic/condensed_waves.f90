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

  !> H' at some orders, J_A. [H_.A - H_.P S_k^-1 T_k] there, and prod_k det S_k, vectorized over
  !! the orders.
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
    !> The columns P, then A, of J_P. H + I; and of H.
    real(wp), dimension(size(h, 1), size(others), size(h, 2)) :: solved_re, solved_im
    real(wp), dimension(size(h, 1), size(h, 2), size(h, 2)) :: h_re, h_im
    real(wp), dimension(size(h, 1)) :: j_re, j_im
    integer :: order(size(h, 2)), a, b, k, n
    logical :: acts(size(h, 2), size(h, 2))

    n = size(others)
    order = [others, swings]
    acts = any(abs(mean) > 0.0_wp, 3) .or. abs(without) > 0.0_wp
    h_re = real(h(:, :, order))
    h_im = aimag(h(:, :, order))
    solved_re = 0.0_wp
    solved_im = 0.0_wp
    do k = 1, size(order)
      do a = 1, n
        if (.not. acts(others(a), k)) cycle
        call entry_of(kept, mean(others(a), k, :), without(others(a), k), j_re, j_im)
        do b = 1, size(order)
          solved_re(:, a, b) = solved_re(:, a, b) + (j_re*h_re(:, k, b) - j_im*h_im(:, k, b))
          solved_im(:, a, b) = solved_im(:, a, b) + (j_re*h_im(:, k, b) + j_im*h_re(:, k, b))
        end do
      end do
    end do
    do a = 1, n
      solved_re(:, a, a) = solved_re(:, a, a) + 1.0_wp
    end do
    call eliminate(size(h, 1), n, size(order), solved_re, solved_im, factor)
    if (.not. abs(factor) > 0.0_wp) return
    own_re = 0.0_wp
    own_im = 0.0_wp
    do k = 1, size(order)
      if (.not. (any(swings == k) .or. any(acts(swings, k)))) cycle
      do b = n + 1, size(order)
        do a = 1, n
          h_re(:, k, b) = h_re(:, k, b) - (h_re(:, k, a)*solved_re(:, a, b) &
                                           - h_im(:, k, a)*solved_im(:, a, b))
          h_im(:, k, b) = h_im(:, k, b) - (h_re(:, k, a)*solved_im(:, a, b) &
                                           + h_im(:, k, a)*solved_re(:, a, b))
        end do
      end do
      do a = 1, size(swings)
        if (.not. acts(swings(a), k)) cycle
        call entry_of(kept, mean(swings(a), k, :), without(swings(a), k), j_re, j_im)
        do b = 1, size(swings)
          own_re(:, a, b) = own_re(:, a, b) + (j_re*h_re(:, k, n + b) - j_im*h_im(:, k, n + b))
          own_im(:, a, b) = own_im(:, a, b) + (j_re*h_im(:, k, n + b) + j_im*h_re(:, k, n + b))
        end do
      end do
    end do
    soft_re = h_re(:, swings, n + 1:)
    soft_im = h_im(:, swings, n + 1:)
  end subroutine soften

  !> One entry of J within each order.
  pure subroutine entry_of(kept, mean, without, re, im)
    complex(wp), intent(in) :: kept(:, :)
    real(wp), intent(in) :: mean(:), without
    real(wp), intent(out) :: re(:), im(:)
    integer :: q
    re = -without
    im = 0.0_wp
    do q = 1, size(mean)
      re = re + real(kept(:, q))*mean(q)
      im = im + aimag(kept(:, q))*mean(q)
    end do
  end subroutine entry_of

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

  !> Solve squares on the left for the columns behind them, in place, with the largest pivots;
  !! the product of their determinants.
  pure subroutine eliminate(p, n, columns, re, im, determinant)
    integer, intent(in) :: p, n, columns
    real(wp), intent(inout), dimension(p, n, columns) :: re, im
    !> 0: one is singular.
    complex(wp), intent(out) :: determinant
    real(wp), dimension(p) :: largest, size_of, f, g
    complex(wp) :: entry(columns)
    integer :: at(p), b, i, j, l

    determinant = (1.0_wp, 0.0_wp)
    do j = 1, n
      at = j
      largest = abs(re(:, j, j)) + abs(im(:, j, j))
      do i = j + 1, n
        size_of = abs(re(:, i, j)) + abs(im(:, i, j))
        at = merge(i, at, size_of > largest)
        largest = max(size_of, largest)
      end do
      do l = 1, p
        i = at(l)
        if (i /= j) then
          entry = cmplx(re(l, i, :), im(l, i, :), wp)
          re(l, i, :) = re(l, j, :)
          im(l, i, :) = im(l, j, :)
          re(l, j, :) = real(entry)
          im(l, j, :) = aimag(entry)
          determinant = -determinant
        end if
        determinant = determinant*cmplx(re(l, j, j), im(l, j, j), wp)
      end do
      if (.not. (abs(determinant) > 0.0_wp .and. all(largest > 0.0_wp))) then
        determinant = (0.0_wp, 0.0_wp)
        return
      end if
      size_of = 1.0_wp/(re(:, j, j)**2 + im(:, j, j)**2)
      do b = j + 1, columns
        f = (re(:, j, b)*re(:, j, j) + im(:, j, b)*im(:, j, j))*size_of
        g = (im(:, j, b)*re(:, j, j) - re(:, j, b)*im(:, j, j))*size_of
        re(:, j, b) = f
        im(:, j, b) = g
        do i = 1, n
          if (i == j) cycle
          re(:, i, b) = re(:, i, b) - (re(:, i, j)*f - im(:, i, j)*g)
          im(:, i, b) = im(:, i, b) - (re(:, i, j)*g + im(:, i, j)*f)
        end do
      end do
    end do
  end subroutine eliminate

end module viscovib_condensed_waves
