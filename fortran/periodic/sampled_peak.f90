!> The largest amplitude of a harmonic between sampled motions, which may lie on several branches
!! and far apart.
!!
!! A resonance between two samples shows in their slopes: the amplitude grows from the left one, or
!! towards the right one, more than the other sample shows. From there the search climbs along the
!! branch of the sample, over all maxima up to the adjacent sample; beyond it lies a different
!! branch. If the slopes do not lead from one sample to the next, the branch is followed too.
module viscovib_sampled_peak
  use viscovib_curve, only: curve_type
  use viscovib_curve_peak, only: climb, growth_along, harmonic_measure
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: peak_of_samples

contains

  !> The largest amplitude of the samples and of the maxima between them.
  subroutine peak_of_samples(curve, measure, tolerance, p, x, wide, best_p, best, found, cancel)
    class(curve_type), intent(inout) :: curve
    type(harmonic_measure), intent(in) :: measure
    real(wp), intent(in) :: tolerance
    !> Parameters, ascending, shape (n), and the motions there, shape (curve%n, n).
    real(wp), intent(in) :: p(:), x(:, :)
    !> True: search between all samples, not only near the largest one.
    logical, intent(in) :: wide
    real(wp), intent(out) :: best_p, best
    !> True if the best point is a maximum between samples.
    logical, intent(out) :: found
    !> May be set by another thread to cancel the search.
    integer, intent(inout), optional :: cancel
    real(wp) :: sizes(size(p)), slopes(size(x, 1), size(p))
    integer :: trend(size(p)), i, largest
    logical :: there

    sizes = [(measure%size_at(x(:, i), p(i)), i=1, size(p))]
    largest = maxloc(sizes, 1)
    best_p = p(largest)
    best = sizes(largest)
    found = .false.
    trend = 0
    do i = 1, size(p)
      if (.not. wide .and. abs(i - largest) > 1) cycle
      if (present(cancel)) then
        if (is_set(cancel)) return
      end if
      call growth_along(curve, measure, tolerance, x(:, i), p(i), trend(i), slopes(:, i))
    end do
    do i = 1, size(p) - 1
      if (.not. wide .and. abs(2*(i - largest) + 1) > 1) cycle
      if (present(cancel)) then
        if (is_set(cancel)) return
      end if
      there = .false.
      ! If both slopes agree upwards there is no maximum between the samples.
      if (trend(i) > 0 .and. .not. (trend(i + 1) > 0 .and. sizes(i + 1) >= sizes(i))) then
        call from_sample(i, .false.)
      end if
      if (there) cycle
      if (trend(i + 1) < 0 .and. .not. (trend(i) < 0 .and. sizes(i) >= sizes(i + 1))) then
        call from_sample(i + 1, .false.)
      end if
      if (there) cycle
      if (hides(i)) call from_sample(i, .true.)
    end do

  contains

    !> True if the secant between two samples differs from the mean of their slopes, for all
    !! unknowns or for the harmonic alone, which may be smaller than other coordinates.
    pure logical function hides(at)
      integer, intent(in) :: at
      real(wp) :: secant(size(x, 1)), off(size(x, 1))
      secant = x(:, at + 1) - x(:, at)
      off = secant - 0.5_wp*(p(at + 1) - p(at))*(slopes(:, at) + slopes(:, at + 1))
      hides = norm2(off) > 0.3_wp*norm2(secant) &
              .or. norm2(off(measure%place)) > 0.3_wp*norm2(secant(measure%place))
    end function hides

    subroutine from_sample(from, upwards)
      integer, intent(in) :: from
      logical, intent(in) :: upwards
      real(wp) :: at(size(x, 1)), at_p, top
      logical :: summit
      at = x(:, from)
      at_p = p(from)
      ! Close modes may have several maxima between two samples.
      there = .true.
      call climb(curve, measure, tolerance, p(i), p(i + 1), at, at_p, summit, cancel, there, &
                 upwards)
      if (.not. summit) return
      top = measure%size_at(at, at_p)
      if (top < best) return
      best = top
      best_p = at_p
      found = .true.
    end subroutine from_sample

  end subroutine peak_of_samples

end module viscovib_sampled_peak
