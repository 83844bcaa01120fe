!> Matrices of Hill's determinant of a condensed structure, real and imaginary parts apart.
module viscovib_condensed_rows
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: fill_one

contains

  !> I + H J where it has one row an order: of one deflection, without rigid bodies.
  pure subroutine fill_one(p, reach, rows, h, kept, local, most, without, re, im)
    !> Orders, how far J reaches, leading dimension, and how far J is held.
    integer, intent(in) :: p, reach, rows, most
    complex(wp), intent(in) :: h(p), kept(:, :), local(-most:most, size(kept, 2))
    !> Of hereditary variables what J is less.
    real(wp), intent(in) :: without
    real(wp), intent(inout) :: re(rows, p), im(rows, p)
    real(wp), dimension(p) :: x, y
    real(wp), dimension(-most:most) :: c, s
    integer :: i, l, q, first, last

    do q = 1, size(kept, 2)
      x = real(h*kept(:, q))
      y = aimag(h*kept(:, q))
      c = real(local(:, q))
      s = aimag(local(:, q))
      do l = 1, p
        first = max(1, l - reach)
        last = min(p, l + reach)
        if (q == 1) then
          ! Rows exchanged fill twice the band above.
          re(max(1, l - 2*reach):first, l) = 0.0_wp
          im(max(1, l - 2*reach):first, l) = 0.0_wp
          do i = first, last
            re(i, l) = x(i)*c(i - l) - y(i)*s(i - l)
            im(i, l) = x(i)*s(i - l) + y(i)*c(i - l)
          end do
        else
          do i = first, last
            re(i, l) = re(i, l) + (x(i)*c(i - l) - y(i)*s(i - l))
            im(i, l) = im(i, l) + (x(i)*s(i - l) + y(i)*c(i - l))
          end do
        end if
      end do
    end do
    do l = 1, p
      re(l, l) = re(l, l) + (1.0_wp - without*real(h(l)))
      im(l, l) = im(l, l) - without*aimag(h(l))
    end do
  end subroutine fill_one

end module viscovib_condensed_rows
