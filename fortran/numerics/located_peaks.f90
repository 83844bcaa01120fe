!> Largest magnitudes of sampled quantities, located between the samples.
!!
!! Near the largest samples the polynomial through the nearest samples is searched, separately on
!! each side of a time at which the quantities are not smooth. A polynomial through fewer samples
!! gives the error.
module viscovib_located_peaks
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: lagrange, lagrange_factors
  use viscovib_sorting, only: sort_reals
  implicit none
  private

  public :: is_loose, locate_peaks, peak_windows

  !> Samples of a polynomial on each side of a sample; samples left out for the error.
  integer, parameter :: n_beside = 6, n_left_out = 2
  !> Samples near which a peak may be: their size as part of the largest, and their number.
  real(wp), parameter :: near = 0.9_wp
  integer, parameter :: most = 4
  !> Parts of an interval that are searched first; parabolas after them, each through places that
  !! are closer by a factor.
  integer, parameter :: n_parts = 8, n_parabolas = 3
  real(wp), parameter :: closer = 0.125_wp
  !> Largest error of a location by the samples, relative to the peak; intervals of the Chebyshev
  !! points of a window.
  real(wp), parameter :: close = 1.0e-9_wp, pi = acos(-1.0_wp)
  integer, parameter :: n_chebyshev = 16

contains

  !> True if a peak needs more samples (`peak_windows`).
  elemental logical function is_loose(peak, error)
    real(wp), intent(in) :: peak, error
    is_loose = error > close*abs(peak)
  end function is_loose

  !> Times at which more samples of a quantity locate its peak, ascending, and the ends of the
  !! windows in which they are: between these ends the samples belong together.
  pure subroutine peak_windows(t, values, times, ends)
    real(wp), intent(in) :: t(:), values(:)
    real(wp), allocatable, intent(out) :: times(:), ends(:)
    real(wp) :: parts(0:n_chebyshev)
    integer :: i, tops(most), n_tops

    parts = [((1.0_wp - cos(pi*i/n_chebyshev))/2.0_wp, i=0, n_chebyshev)]
    call find_tops(values, maxval(abs(values)), tops, n_tops)
    allocate (times(0), ends(0))
    do i = 1, n_tops
      associate (a => t(max(tops(i) - 1, 1)), b => t(min(tops(i) + 1, size(t))))
        ends = [ends, a, b]
        times = [times, a + (b - a)*parts]
      end associate
    end do
    call sort_reals(times)
    times = [times(1), pack(times(2:), times(2:) > times(:size(times) - 1))]
  end subroutine peak_windows

  !> The largest samples that are not below their neighbours, in descending order.
  pure subroutine find_tops(values, largest, tops, n_tops)
    real(wp), intent(in) :: values(:), largest
    integer, intent(out) :: tops(most), n_tops
    real(wp) :: here
    integer :: i, n
    n = size(values)
    tops = 1
    n_tops = 0
    do i = 1, n
      here = abs(values(i))
      if (here < near*largest) cycle
      if (here < abs(values(max(i - 1, 1))) .or. here < abs(values(min(i + 1, n)))) cycle
      call insert(values, i, tops, n_tops)
    end do
  end subroutine find_tops

  !> Peaks of several quantities.
  pure subroutine locate_peaks(t, values, breaks, peak, at, error)
    !> Ascending times, shape (n), and the quantities, shape (n, m).
    real(wp), intent(in) :: t(:)
    real(wp), intent(in), contiguous :: values(:, :)
    !> Ascending times at which the quantities may not be smooth.
    real(wp), intent(in) :: breaks(:)
    !> Values with their signs, their times, and the errors of their location, shape (m).
    real(wp), intent(out) :: peak(:), at(:), error(:)
    integer :: i, k, n, tops(most), n_tops
    real(wp) :: here, largest

    n = size(t)
    do k = 1, size(values, 2)
      largest = maxval(abs(values(:, k)))
      call find_tops(values(:, k), largest, tops, n_tops)
      peak(k) = values(tops(1), k)
      at(k) = t(tops(1))
      error(k) = 0.0_wp
      do i = 1, n_tops
        here = abs(values(tops(i), k))
        ! A value between samples exceeds them by less than they differ.
        if (i > 1 .and. 2.0_wp*here - min(abs(values(max(tops(i) - 1, 1), k)), &
                                          abs(values(min(tops(i) + 1, n), k))) < abs(peak(k))) cycle
        call search_near(t, values(:, k), breaks, tops(i), peak(k), at(k), error(k))
      end do
      error(k) = max(error(k), 4.0_wp*epsilon(1.0_wp)*largest)
    end do
  end subroutine locate_peaks

  !> Keep a sample if it is among the largest; these are in descending order.
  pure subroutine insert(values, i, tops, n)
    real(wp), intent(in) :: values(:)
    integer, intent(in) :: i
    integer, intent(inout) :: tops(:), n
    integer :: j
    n = min(n + 1, most)
    do j = n, 2, -1
      if (abs(values(i)) <= abs(values(tops(j - 1)))) exit
      tops(j) = tops(j - 1)
    end do
    tops(j) = i
  end subroutine insert

  !> Search the intervals before and after a sample.
  pure subroutine search_near(t, values, breaks, i, peak, at, error)
    real(wp), intent(in) :: t(:), values(:), breaks(:)
    integer, intent(in) :: i
    !> The largest so far.
    real(wp), intent(inout) :: peak, at, error
    real(wp) :: low, high, end, value, place, off
    integer :: b

    low = t(max(i - 1, 1))
    end = t(min(i + 1, size(t)))
    b = 1
    do while (low < end)
      do while (b <= size(breaks))
        if (breaks(b) > low) exit
        b = b + 1
      end do
      high = end
      if (b <= size(breaks)) high = min(high, breaks(b))
      call search_between(t, values, breaks, i, low, high, value, place, off)
      if (abs(value) >= abs(peak)) then
        peak = value
        at = place
        error = off
      else
        error = max(error, abs(value) + off - abs(peak))
      end if
      low = high
    end do
  end subroutine search_near

  !> Search between two times near a sample, where the quantity is smooth. A sample at the end of
  !! the smooth part may belong to the next part.
  pure subroutine search_between(t, values, breaks, i, low, high, value, place, error)
    real(wp), intent(in) :: t(:), values(:), breaks(:), low, high
    integer, intent(in) :: i
    real(wp), intent(out) :: value, place, error
    real(wp) :: other(3)
    integer :: first, last, m

    first = max(1, i - 2*n_beside)
    last = min(size(t), i + 2*n_beside)
    if (any(breaks <= low)) first = max(first, first_from(maxval(breaks, mask=breaks <= low)))
    if (any(breaks >= high)) then
      last = min(last, first_from(nearest(minval(breaks, mask=breaks >= high), 1.0_wp)) - 1)
    end if
    last = max(first, last)
    m = min(2*n_beside, last - first)
    first = min(max(first, i - n_beside), last - m)
    last = first + m
    call find_summit(t(first:last), values(first:last), low, high, value, place, error)
    if (m == 0 .or. t(last) < high .or. .not. any(breaks >= high)) return
    call find_summit(t(first:last - 1), values(first:last - 1), low, high, other(1), other(2), &
                     other(3))
    if (other(3) >= error) return
    value = other(1)
    place = other(2)
    error = other(3)

  contains

    !> Index of the first sample from a time on.
    pure integer function first_from(time)
      real(wp), intent(in) :: time
      first_from = first + count(t(first:last) < time)
    end function first_from

  end subroutine search_between

  !> Largest magnitude of the polynomial through samples between two times, and its error.
  pure subroutine find_summit(t, values, low, high, value, place, error)
    real(wp), intent(in) :: t(:), values(:), low, high
    real(wp), intent(out) :: value, place, error
    real(wp) :: s(size(t)), factors(size(t)), x, step, best, bend, around(2), scale
    integer :: first, j, last

    scale = max(t(size(t)) - t(1), high - low)
    s = (t - t(1))/scale
    factors = lagrange_factors(s)
    step = (high - low)/n_parts
    place = low
    best = abs(value_at(low))
    do j = 1, n_parts
      x = low + j*step
      if (abs(value_at(x)) <= best) cycle
      best = abs(value_at(x))
      place = x
    end do
    do j = 1, n_parabolas
      around = abs([value_at(place - step), value_at(place + step)])
      bend = around(1) - 2.0_wp*best + around(2)
      if (bend >= 0.0_wp) exit
      x = place + step*max(-1.0_wp, min(1.0_wp, 0.5_wp*(around(1) - around(2))/bend))
      x = max(low, min(high, x))
      if (abs(value_at(x)) >= best) then
        best = abs(value_at(x))
        place = x
      end if
      step = closer*step
    end do
    value = value_at(place)
    first = 1
    last = size(t)
    do j = 1, min(n_left_out, size(t) - 1)
      if (place - t(first) > t(last) - place) then
        first = first + 1
      else
        last = last - 1
      end if
    end do
    error = abs(value)
    if (size(t) == 1) return
    error = abs(value - dot_product(values(first:last), &
                                    lagrange(s(first:last), lagrange_factors(s(first:last)), &
                                             (place - t(1))/scale)))

  contains

    pure real(wp) function value_at(x)
      real(wp), intent(in) :: x
      value_at = dot_product(values, lagrange(s, factors, (x - t(1))/scale))
    end function value_at

  end subroutine find_summit

end module viscovib_located_peaks
