!> Attractors of motions from many starts: the rules that determine basins of attraction.
!!
!! The last points of each motion are given: states a load period apart, or for a system
!! without a load two states some time apart. A motion has settled on period p if its last p points
!! repeat the previous p points. Motions with nearby last points settle on the same orbit.
!!
!! A start may be on a saddle or on its stable manifold, and a motion may creep, so that the last
!! points show only a part of the remaining change. An orbit therefore counts as an attractor only
!! if the motion stays there for another run time, and nearby motions approach it.
module viscovib_basin_rules
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: find_orbits, disturbances, check_orbit, comes_to_rest

  !> Labels of motions that have not settled, and of motions that did not reach their end.
  integer, parameter, public :: unsettled = -1, has_left = -2
  !> Perturbations that distinguish an attractor from a saddle, each with its negative.
  integer, parameter :: n_pushes = 3
  !> The orbit itself and all perturbed motions.
  integer, parameter, public :: n_disturbed = 1 + 2*n_pushes
  !> Largest remaining perturbation of an attractor; largest motion at rest, relative to the
  !! scale; distance of states of one orbit, and size of perturbations, in units of the tolerance.
  real(wp), parameter :: nearer = 0.5_wp, stands = 1.0e-12_wp, alike = 10.0_wp, pushed = 3.0_wp
  !> Smaller coordinates than this part of the largest one are measured by this part of it.
  real(wp), parameter :: smallest = 1.0e-9_wp, least_scale = 1.0e-290_wp
  real(wp), parameter :: golden = 0.6180339887498949_wp

contains

  !> Label motions by the orbits that their last points repeat, those with more starts first.
  subroutine find_orbits(largest, points, ended, most, near, fastest, scale, labels, periods, &
                         moved, shown, n_orbits)
    !> Largest absolute value of each number of a state in the starts and runs; last points of each
    !! motion, shape (width, n_points, n).
    real(wp), intent(in) :: largest(:), points(:, :, :)
    !> Whether a motion reached its end.
    logical, intent(in) :: ended(:)
    !> Longest period considered; largest distance of states that count as equal, of the scale.
    integer, intent(in) :: most
    real(wp), intent(in) :: near
    !> Fastest frequency; converts velocities to displacements. 0: unknown.
    real(wp), intent(in) :: fastest
    !> Scale of each number of a state.
    real(wp), intent(out) :: scale(:)
    !> The orbit of each motion, from 0; its period, 0 if it has not settled; its remaining change
    !! in a period, of the scale.
    integer, intent(out) :: labels(:), periods(:)
    real(wp), intent(out) :: moved(:)
    !> A representative motion of each orbit: the one that repeats best.
    integer, intent(out) :: shown(:), n_orbits
    real(wp) :: last(size(scale), size(points, 2)), apart
    integer :: i, n, p

    call find_scale(largest, points, ended, fastest, scale)
    n = size(points, 2)
    labels = merge(unsettled, has_left, ended)
    periods = 0
    moved = ieee_value(1.0_wp, ieee_quiet_nan)
    do i = 1, size(ended)
      if (.not. ended(i)) cycle
      last = points(:, :, i)/spread(scale, 2, n)
      moved(i) = huge(1.0_wp)
      do p = 1, most
        ! The whole last period must repeat; a single state may repeat by chance.
        apart = maxval(abs(last(:, n - p + 1:) - last(:, n - 2*p + 1:n - p)))
        moved(i) = min(moved(i), apart)
        if (apart > near) cycle
        periods(i) = p
        moved(i) = apart
        exit
      end do
    end do
    n_orbits = 0
    do p = 1, most
      call gather(points, periods == p, p, moved, near, scale, labels, shown, n_orbits)
    end do
    call by_size(labels, shown, n_orbits)
  end subroutine find_orbits

  !> Largest absolute value of each number of a state, including last points; with a known
  !! frequency, displacements and velocities share a scale.
  subroutine find_scale(largest, points, ended, fastest, scale)
    real(wp), intent(in) :: largest(:), points(:, :, :), fastest
    logical, intent(in) :: ended(:)
    real(wp), intent(out) :: scale(:)
    integer :: i

    scale = largest
    do i = 1, size(ended)
      if (ended(i)) scale = max(scale, maxval(abs(points(:, :, i)), 2))
    end do
    if (fastest > 0.0_wp) then
      do i = 1, size(scale), 2
        scale(i) = max(scale(i), scale(i + 1)/fastest)
        scale(i + 1) = fastest*scale(i)
      end do
    end if
    scale = max(scale, smallest*max(maxval(scale), least_scale))
  end subroutine find_scale

  !> The orbits of motions of one period: the motion that repeats best represents an orbit, and all
  !! nearby motions belong to it.
  subroutine gather(points, here, period, moved, near, scale, labels, shown, n_orbits)
    real(wp), intent(in) :: points(:, :, :), moved(:), near, scale(:)
    logical, intent(in) :: here(:)
    integer, intent(in) :: period
    integer, intent(inout) :: labels(:), shown(:), n_orbits
    real(wp) :: orbit(size(scale), period), own(size(scale)), apart
    integer, allocatable :: left(:)
    logical, allocatable :: same(:)
    integer :: best, i, k, n

    n = size(points, 2)
    left = pack([(i, i=1, size(here))], here)
    do while (size(left) > 0)
      best = minloc(moved(left), 1)
      n_orbits = n_orbits + 1
      shown(n_orbits) = left(best)
      orbit = points(:, n - period + 1:, left(best))/spread(scale, 2, period)
      same = [(i == best, i=1, size(left))]
      do i = 1, size(left)
        own = points(:, n, left(i))/scale
        apart = huge(1.0_wp)
        do k = 1, period
          apart = min(apart, maxval(abs(own - orbit(:, k))))
        end do
        same(i) = same(i) .or. apart <= alike*near
      end do
      labels(pack(left, same)) = n_orbits - 1
      left = pack(left, .not. same)
    end do
  end subroutine gather

  !> Number orbits by decreasing numbers of starts; equal numbers in the order of detection.
  subroutine by_size(labels, shown, n_orbits)
    integer, intent(inout) :: labels(:), shown(:)
    integer, intent(in) :: n_orbits
    integer :: counts(0:n_orbits - 1), new(unsettled - 1:n_orbits - 1), order(n_orbits), i, place

    counts = 0
    do i = 1, size(labels)
      if (labels(i) >= 0) counts(labels(i)) = counts(labels(i)) + 1
    end do
    new = [(i, i=unsettled - 1, n_orbits - 1)]
    do i = 1, n_orbits
      place = maxloc(counts, 1) - 1
      counts(place) = -1
      new(place) = i - 1
      order(i) = shown(place + 1)
    end do
    shown(:n_orbits) = order
    labels = new(labels)
  end subroutine by_size

  !> Perturbations of an orbit, relative to the scale, one column per motion, the first column zero.
  !! They have no special direction: displacements and velocities have equal or opposite signs,
  !! since damping may cancel the effect of a displacement and a velocity on each other.
  pure subroutine disturbances(near, pushes)
    real(wp), intent(in) :: near
    !> Shape (width, n_disturbed).
    real(wp), intent(out) :: pushes(:, :)
    integer :: i, j, k

    pushes(:, 1) = 0.0_wp
    do j = 1, n_pushes
      do i = 1, size(pushes, 1)
        k = (j - 1)*size(pushes, 1) + i
        pushes(i, 1 + j) = pushed*near*(0.5_wp + 0.5_wp*modulo(k*golden, 1.0_wp))
        if (mod((i - 1)/max(j - 1, 1), 2) == 1 .and. j > 1) pushes(i, 1 + j) = -pushes(i, 1 + j)
        pushes(i, 1 + n_pushes + j) = -pushes(i, 1 + j)
      end do
    end do
  end subroutine disturbances

  !> Test if an orbit attracts, by the ends of motions from it with the perturbations above.
  !!
  !! An orbit that is constant to the last digits is at rest: friction holds it anywhere, and
  !! neighbours stay where they are. If the state has memory, a start that settles there is
  !! perturbed instead: most motions must return, as the start may be near a basin boundary, and
  !! with kernels the returning ones must have come nearer, since some perturbations decay fast.
  subroutine check_orbit(ends, ended, orbit, scale, near, of_starts, has_kernels, attracts, rest)
    !> Shapes (width, n_disturbed), (n_disturbed) and (width, period).
    real(wp), intent(in) :: ends(:, :), orbit(:, :), scale(:), near
    logical, intent(in) :: ended(:)
    !> True if starts were perturbed; true if nearby motions must then come nearer.
    logical, intent(in) :: of_starts, has_kernels
    logical, intent(out) :: attracts
    !> The largest remaining part of a perturbation; huge: unknown.
    real(wp), intent(out) :: rest
    real(wp) :: pushes(size(scale), n_disturbed), away(n_disturbed), parts(2:n_disturbed)
    logical, dimension(2:n_disturbed) :: back, come
    integer :: i, k

    attracts = .false.
    rest = huge(1.0_wp)
    if (.not. all(ended)) return
    call disturbances(near, pushes)
    away = huge(1.0_wp)
    do i = 1, n_disturbed
      do k = 1, size(orbit, 2)
        away(i) = min(away(i), maxval(abs(ends(:, i)/scale - orbit(:, k)/scale)))
      end do
    end do
    do i = 2, n_disturbed
      ! Distance of nearby motions from the motion itself.
      parts(i) = maxval(abs(ends(:, i)/scale - ends(:, 1)/scale))/minval(abs(pushes(:, i)))
    end do
    rest = maxval(parts)
    back = away(2:) <= alike*near
    come = parts <= nearer
    if (of_starts) then
      attracts = 2*count(back) > size(back)
      if (has_kernels) attracts = attracts .and. all(come .or. .not. back)
    else
      attracts = all(back) .and. away(1) <= 2.0_wp*near .and. (all(come) .or. away(1) <= stands)
    end if
  end subroutine check_orbit

  !> True if a motion moves less from period to period at the end of a run twice as long, or is at
  !! rest. With sticking friction, neighbours stay where they are and do not show creeping.
  pure logical function comes_to_rest(points, later, period, scale) result(comes)
    !> Last points of both runs, shape (width, n_points); those of a run that ended early are NaN.
    real(wp), intent(in) :: points(:, :), later(:, :), scale(:)
    integer, intent(in) :: period
    comes = moved(later) <= max(nearer*moved(points), stands)

  contains

    !> The last period less the one before.
    pure real(wp) function moved(seen)
      real(wp), intent(in) :: seen(:, :)
      real(wp) :: changes(size(seen, 1), period)
      integer :: n
      n = size(seen, 2)
      changes = abs(seen(:, n - period + 1:) - seen(:, n - 2*period + 1:n - period)) &
                /spread(scale, 2, period)
      moved = maxval(changes)
      if (any(changes /= changes)) moved = huge(1.0_wp)
    end function moved

  end function comes_to_rest

end module viscovib_basin_rules
