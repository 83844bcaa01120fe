!> Matrices of Hill's determinant of a condensed structure, real and imaginary parts apart.
module viscovib_condensed_rows
  use viscovib_kinds, only: wp
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: fill_one, strength

  !> Times at which H J is looked at.
  integer, parameter :: some_times = 16

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

  !> How large H J is at s at some times, whatever the units: |(H J)^4|^(1/4).
  real(wp) function strength(system, kernel_of_group, slopes, s, h)
    class(structure_type), intent(in) :: system
    !> Kernel of each group, and slopes of the variables along the motion, shape (n_samples,
    !! n_memory, n_dof).
    integer, intent(in) :: kernel_of_group(:)
    real(wp), intent(in) :: slopes(:, :, :)
    complex(wp), intent(in) :: s, h(:, :)
    complex(wp) :: x(size(h, 1), size(h, 1)), kept(size(kernel_of_group)), f(1)
    real(wp) :: slope(size(h, 1))
    integer :: b, i, j, q

    kept = (1.0_wp, 0.0_wp)
    do q = 1, size(kept)
      if (kernel_of_group(q) == 0) cycle
      call system%kernels(kernel_of_group(q))%kernel%laplace([s], f)
      kept(q) = 1.0_wp - system%memory_scale*f(1)
    end do
    strength = 0.0_wp
    do i = 1, size(slopes, 1), max(1, size(slopes, 1)/some_times)
      x = (0.0_wp, 0.0_wp)
      do j = 1, size(slopes, 2)
        q = findloc(kernel_of_group, system%kernel_of(j), 1)
        slope = 0.0_wp
        if (system%bent(j)) slope = slopes(i, j, :)
        do b = 1, size(h, 1)
          x(:, b) = x(:, b) + system%spread(:, j)*(kept(q)*slope(b))
          if (system%kernel_of(j) > 0) then
            x(:, b) = x(:, b) + system%spread(:, j)*((kept(q) - 1.0_wp)*system%gather(j, b))
          end if
        end do
      end do
      x = matmul(h, x)
      if (size(h, 1) > 1) then
        x = matmul(x, x)
        x = matmul(x, x)
        strength = max(strength, maxval(sum(abs(x), 2))**0.25_wp)
      else
        strength = max(strength, abs(x(1, 1)))
      end if
    end do
  end function strength

end module viscovib_condensed_rows
