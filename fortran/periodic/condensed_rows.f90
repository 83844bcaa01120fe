! Optimize: -O2 -fvect-cost-model=dynamic
!> Matrices of Hill's determinant of a condensed structure, real and imaginary parts apart.
module viscovib_condensed_rows
  use viscovib_hill_blocks, only: moments_of
  use viscovib_hill_determinant, only: retained_of
  use viscovib_kinds, only: wp
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: fill_one, find_swings, measure_waves, strength, waves_of_rates

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

  !> Norms of J_m, m = 1, ..., and how large a part it is of the largest J, whatever the units.
  pure subroutine measure_waves(local, by_rate, largest, strongest, sizes, parts)
    !> J and what multiplies rates, by the difference of orders.
    complex(wp), allocatable, intent(in) :: local(:, :, :, :), by_rate(:, :, :, :)
    real(wp), intent(in) :: largest(:, :), strongest(:, :)
    real(wp), allocatable, intent(out) :: sizes(:), parts(:)
    integer :: m, most

    most = ubound(local, 3)
    allocate (sizes(most), parts(most))
    do m = 1, most
      associate (wave => abs(sum(local(:, :, m, :), 3)))
        sizes(m) = maxval(sum(wave, 2))
        parts(m) = maxval(wave/max(largest, tiny(1.0_wp)))
      end associate
      if (.not. allocated(by_rate)) cycle
      parts(m) = max(parts(m), maxval(abs(sum(by_rate(:, :, m, :), 3)) &
                                      /max(strongest, tiny(1.0_wp))))
    end do
  end subroutine measure_waves

  !> Deflections whose stiffness swings, and the others.
  pure subroutine find_swings(local, swings, others)
    complex(wp), allocatable, intent(in) :: local(:, :, :, :)
    integer, allocatable, intent(out) :: swings(:), others(:)
    logical :: swing(size(local, 1))
    integer :: a

    do a = 1, size(swing)
      swing(a) = any(abs(local(a, :, 1:, :)) > 0.0_wp) .or. any(abs(local(:, a, 1:, :)) > 0.0_wp)
    end do
    swings = pack([(a, a=1, size(swing))], swing)
    others = pack([(a, a=1, size(swing))], .not. swing)
  end subroutine find_swings

  !> The part of J that the rate of a deflection multiplies, and the largest it is at any time.
  subroutine waves_of_rates(system, group, slopes, waves, by_rate, strongest)
    class(structure_type), intent(in) :: system
    !> Group of each variable; slopes by rates, shape (n_samples, n_memory, n_rates);
    !! exp(-2 pi i m/n)/n of so many samples.
    integer, intent(in) :: group(:)
    real(wp), intent(in) :: slopes(:, :, :)
    complex(wp), intent(in) :: waves(0:)
    !> By the difference of orders and group, shape (n_dof, n_dof, -most:most, groups), and (n_dof,
    !! n_dof).
    complex(wp), allocatable, intent(inout) :: by_rate(:, :, :, :)
    real(wp), intent(inout) :: strongest(:, :)
    complex(wp) :: moments(-(size(slopes, 1) - 1)/2:(size(slopes, 1) - 1)/2)
    integer :: b, j, m, most

    most = ubound(moments, 1)
    if (allocated(by_rate)) deallocate (by_rate)
    allocate (by_rate(size(strongest, 1), size(strongest, 1), -most:most, maxval(group)), &
              source=(0.0_wp, 0.0_wp))
    do j = 1, size(slopes, 2)
      if (.not. system%bent(j)) cycle
      do b = 1, system%n_rates()
        associate (column => system%rates(b))
          strongest(:, column) = strongest(:, column) + abs(system%spread(:, j)) &
                                 *maxval(abs(slopes(:, j, b)))
          call moments_of(waves, .true., slopes(:, j, b), 0.0_wp, moments)
          do m = -most, most
            by_rate(:, column, m, group(j)) = by_rate(:, column, m, group(j)) &
                                              + system%spread(:, j)*moments(m)
          end do
        end associate
      end do
    end do
  end subroutine waves_of_rates

  !> How large H J is at s at some times, whatever the units: |(H J)^4|^(1/4).
  real(wp) function strength(system, kernel_of_group, slopes, s, h)
    class(structure_type), intent(in) :: system
    !> Kernel of each group, and slopes of the variables along the motion, shape (n_samples,
    !! n_memory, n_dof + n_rates).
    integer, intent(in) :: kernel_of_group(:)
    real(wp), intent(in) :: slopes(:, :, :)
    complex(wp), intent(in) :: s, h(:, :)
    real(wp), dimension((size(slopes, 1) - 1)/step_of(slopes) + 1, size(h, 1), size(h, 1)) :: &
      re, im, next_re, next_im
    complex(wp), dimension(size(re, 1)) :: slope
    complex(wp) :: kept(1, size(kernel_of_group))
    integer :: a, b, c, j, k, n, q

    n = size(h, 1)
    kept = retained_of(system, kernel_of_group, [s])
    next_re = 0.0_wp
    next_im = 0.0_wp
    do j = 1, size(slopes, 2)
      q = findloc(kernel_of_group, system%kernel_of(j), 1)
      do b = 1, n
        slope = (0.0_wp, 0.0_wp)
        if (system%bent(j)) then
          slope = slopes(::step_of(slopes), j, b)
          do c = 1, system%n_rates()
            if (system%rates(c) == b) slope = slope + s*slopes(::step_of(slopes), j, n + c)
          end do
        end if
        slope = kept(1, q)*slope
        if (system%kernel_of(j) > 0) slope = slope + (kept(1, q) - 1.0_wp)*system%gather(j, b)
        do k = 1, merge(n, 0, any(abs(slope) > 0.0_wp))
          if (.not. abs(system%spread(k, j)) > 0.0_wp) cycle
          do a = 1, n
            next_re(:, a, b) = next_re(:, a, b) + real(h(a, k)*system%spread(k, j)*slope)
            next_im(:, a, b) = next_im(:, a, b) + aimag(h(a, k)*system%spread(k, j)*slope)
          end do
        end do
      end do
    end do
    call square(size(re, 1), n, next_re, next_im, re, im)
    call square(size(re, 1), n, re, im, next_re, next_im)
    strength = maxval(sum(sqrt(next_re**2 + next_im**2), 3))**0.25_wp
  end function strength

  !> From one time to the next.
  pure integer function step_of(slopes)
    real(wp), intent(in) :: slopes(:, :, :)
    step_of = max(1, size(slopes, 1)/some_times)
  end function step_of

  !> Squares of n_times complex matrices.
  pure subroutine square(n_times, n, x_re, x_im, re, im)
    integer, intent(in) :: n_times, n
    real(wp), intent(in), dimension(n_times, n, n) :: x_re, x_im
    real(wp), intent(out), dimension(n_times, n, n) :: re, im
    integer :: a, b, k

    re = 0.0_wp
    im = 0.0_wp
    do b = 1, n
      do k = 1, n
        do a = 1, n
          re(:, a, b) = re(:, a, b) + (x_re(:, a, k)*x_re(:, k, b) - x_im(:, a, k)*x_im(:, k, b))
          im(:, a, b) = im(:, a, b) + (x_re(:, a, k)*x_im(:, k, b) + x_im(:, a, k)*x_re(:, k, b))
        end do
      end do
    end do
  end subroutine square

end module viscovib_condensed_rows
