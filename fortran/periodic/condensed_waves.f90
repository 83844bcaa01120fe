! Optimize: -O3
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
  use viscovib_lanes, only: n_lanes
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
    !> The columns P, then A, of J_P. H + I; of H; and J_A. H'. Whole registers of orders.
    real(wp), dimension(whole(size(h, 1)), size(others), size(h, 2)) :: solved_re, solved_im
    real(wp), dimension(size(solved_re, 1), size(h, 2), size(h, 2)) :: h_re, h_im
    real(wp), dimension(size(solved_re, 1), size(swings), size(swings)) :: of_re, of_im
    real(wp), dimension(size(solved_re, 1)) :: j_re, j_im
    integer :: order(size(h, 2)), a, b, k, n, p
    logical :: acts(size(h, 2), size(h, 2))

    n = size(others)
    p = size(h, 1)
    order = [others, swings]
    acts = any(abs(mean) > 0.0_wp, 3) .or. abs(without) > 0.0_wp
    h_re(:p, :, :) = real(h(:, :, order))
    h_im(:p, :, :) = aimag(h(:, :, order))
    h_re(p + 1:, :, :) = 0.0_wp
    h_im(p + 1:, :, :) = 0.0_wp
    j_re = 0.0_wp
    j_im = 0.0_wp
    solved_re = 0.0_wp
    solved_im = 0.0_wp
    do k = 1, size(order)
      do a = 1, n
        if (.not. acts(others(a), k)) cycle
        call entry_of(kept, mean(others(a), k, :), without(others(a), k), j_re(:p), j_im(:p))
        do b = 1, size(order)
          solved_re(:, a, b) = solved_re(:, a, b) + (j_re*h_re(:, k, b) - j_im*h_im(:, k, b))
          solved_im(:, a, b) = solved_im(:, a, b) + (j_re*h_im(:, k, b) + j_im*h_re(:, k, b))
        end do
      end do
    end do
    do a = 1, n
      solved_re(:, a, a) = solved_re(:, a, a) + 1.0_wp
    end do
    call eliminate(size(j_re), n, size(order), solved_re, solved_im, factor)
    if (.not. abs(factor) > 0.0_wp) return
    of_re = 0.0_wp
    of_im = 0.0_wp
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
        call entry_of(kept, mean(swings(a), k, :), without(swings(a), k), j_re(:p), j_im(:p))
        do b = 1, size(swings)
          of_re(:, a, b) = of_re(:, a, b) + (j_re*h_re(:, k, n + b) - j_im*h_im(:, k, n + b))
          of_im(:, a, b) = of_im(:, a, b) + (j_re*h_im(:, k, n + b) + j_im*h_re(:, k, n + b))
        end do
      end do
    end do
    soft_re = h_re(:p, swings, n + 1:)
    soft_im = h_im(:p, swings, n + 1:)
    own_re = of_re(:p, :, :)
    own_im = of_im(:p, :, :)
  end subroutine soften

  !> The next multiple of the lanes of a register.
  pure integer function whole(n)
    integer, intent(in) :: n
    whole = n_lanes*((n + n_lanes - 1)/n_lanes)
  end function whole

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
    !> J by the difference of orders, and what is kept at each row; zeros up to whole registers.
    real(wp), dimension(size(swings)*(2*reach + 1) + n_lanes, size(swings), size(kept, 2)) :: c, s
    real(wp), dimension(size(swings)*p + n_lanes, size(kept, 2)) :: kept_re, kept_im
    integer :: a, b, l, m, n, q, first, last, row, column

    n = size(swings)
    c = 0.0_wp
    s = 0.0_wp
    do q = 1, size(kept, 2)
      do b = 1, n
        do m = -reach, reach
          do a = 1, n
            associate (wave => local(swings(a), swings(b), (size(local, 3) + 1)/2 + m, q))
              c((m + reach)*n + a, b, q) = real(wave)
              s((m + reach)*n + a, b, q) = aimag(wave)
            end associate
          end do
        end do
      end do
    end do
    kept_re = 0.0_wp
    kept_im = 0.0_wp
    do a = 1, n
      kept_re(a:n*p:n, :) = real(kept)
      kept_im(a:n*p:n, :) = aimag(kept)
    end do
    do l = 1, p
      first = max(1, l - reach)
      last = min(p, l + reach)
      row = (first - 1)*n + 1
      column = (l - 1)*n
      do b = 1, n
        re(:n*p + n_lanes, column + b) = 0.0_wp
        im(:n*p + n_lanes, column + b) = 0.0_wp
        do q = 1, size(kept, 2)
          call add_waves(whole(n*(last - first + 1)), n, size(c, 1), kept_re(row, q), &
                         kept_im(row, q), c(row - column + reach*n, 1, q), &
                         s(row - column + reach*n, 1, q), soft_re(l, :, b), soft_im(l, :, b), &
                         re(row, column + b), im(row, column + b))
        end do
        re(column + 1:column + n, column + b) = own_re(l, :, b)
        im(column + 1:column + n, column + b) = own_im(l, :, b)
        re(column + b, column + b) = re(column + b, column + b) + 1.0_wp
      end do
    end do
  end subroutine fill_waves

  !> One column of J H', of one kernel.
  pure subroutine add_waves(n_rows, n, rows, kept_re, kept_im, c, s, f, g, re, im)
    !> Rows of the column that J reaches, in whole registers; columns of J; its leading dimension.
    integer, intent(in) :: n_rows, n, rows
    !> What is kept at the order of each row.
    real(wp), intent(in) :: kept_re(n_rows), kept_im(n_rows)
    !> J, and a column of H', real and imaginary parts.
    real(wp), intent(in) :: c(rows, n), s(rows, n), f(n), g(n)
    real(wp), intent(inout) :: re(n_rows), im(n_rows)
    real(wp), dimension(n_lanes) :: x, y
    integer :: b, i, l

    do i = 0, n_rows - 1, n_lanes
      x = 0.0_wp
      y = 0.0_wp
      do b = 1, n
        !GCC$ unroll 1
        do l = 1, n_lanes
          x(l) = x(l) + (f(b)*c(i + l, b) - g(b)*s(i + l, b))
          y(l) = y(l) + (f(b)*s(i + l, b) + g(b)*c(i + l, b))
        end do
      end do
      !GCC$ unroll 1
      do l = 1, n_lanes
        re(i + l) = re(i + l) + (kept_re(i + l)*x(l) - kept_im(i + l)*y(l))
        im(i + l) = im(i + l) + (kept_re(i + l)*y(l) + kept_im(i + l)*x(l))
      end do
    end do
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
