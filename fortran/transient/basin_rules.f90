!> What motions from many starts settle on: the rules by which basins of attraction are found.
!!
!! Of each motion the last points are known: states a period of the load apart, or of a system
!! without a load two states some time apart. It has settled on period p where its last p points
!! repeat the p before them; motions whose last points are near each other settle on one orbit.
!!
!! A start may lie on a saddle, or on what leads to one, and a motion may creep: of what it has left
!! to go, a look sees a part. So an orbit attracts only if as long again as the run was the motion
!! stays where it is, and nearby motions come nearer.
module viscovib_basin_rules
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: find_orbits, disturbances, judge_orbit

  !> Labels of what has not settled, and of what did not reach its end.
  integer, parameter, public :: unsettled = -1, has_left = -2
  !> Perturbations that distinguish an attractor from a saddle, each with its negative.
  integer, parameter :: n_pushes = 3
  !> The orbit itself, and with all of these.
  integer, parameter, public :: n_disturbed = 1 + 2*n_pushes
  !> Largest remaining perturbation of an attractor; how little a rest moves, of the
  !! scale; how many tolerances states of one orbit are apart, and as many again the pushes.
  real(wp), parameter :: nearer = 0.5_wp, stands = 1.0e-12_wp, alike = 10.0_wp, pushed = 3.0_wp
  !> Coordinates that are smaller than this part of the largest are measured by that part of it.
  real(wp), parameter :: smallest = 1.0e-9_wp, least_scale = 1.0e-290_wp
  real(wp), parameter :: golden = 0.6180339887498949_wp

contains

  !> Label motions by the orbits that their last points repeat, those with more starts first.
  subroutine find_orbits(largest, points, ended, most, near, fastest, scale, labels, periods, &
                         moved, shown, n_orbits)
    !> The largest of each number of a state in starts and on the way; last points of each motion,
    !! shape (width, n_points, n).
    real(wp), intent(in) :: largest(:), points(:, :, :)
    !> Whether a motion reached its end.
    logical, intent(in) :: ended(:)
    !> The longest period looked for; how near states are that count as the same, of the scale.
    integer, intent(in) :: most
    real(wp), intent(in) :: near
    !> Fastest frequency: velocities count as the displacements times it. 0: not known.
    real(wp), intent(in) :: fastest
    !> Scale of each number of a state.
    real(wp), intent(out) :: scale(:)
    !> The orbit of each motion, from 0; its period, 0 if it has not settled; by how much it still
    !! changes in a period, of the scale.
    integer, intent(out) :: labels(:), periods(:)
    real(wp), intent(out) :: moved(:)
    !> The motion that shows each orbit: that which repeats best.
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
        ! The whole of the last period must repeat, not one state of it by chance.
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

  !> The largest of each number of a state, at ends too; displacements determine what counts as
  !! slow.
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

  !> The orbits of motions of one period: that which repeats best shows one, and has with it all
  !! that are near.
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

  !> Number orbits by falling numbers of starts; of as many, in the order in which they were found.
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

  !> By what an orbit is disturbed, of the scale, a column a motion: the first by nothing. No
  !! direction is special; velocities with displacements, against them, and coordinates against each
  !! other, as what dampers leave of a velocity may take back what a displacement was.
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

  !> Whether an orbit attracts, by the ends of motions from it, disturbed as above.
  !!
  !! What stands still to the last digits is at rest: friction holds it anywhere, and neighbours
  !! stay where they are. Where a state is more than its numbers, what is disturbed is a start that
  !! settles there; most must come back, as it may lie near a border, and with kernels all of these
  !! must have come nearer: some disturbances are gone soon, though the motion creeps.
  subroutine judge_orbit(ends, ended, orbit, scale, near, of_starts, has_kernels, attracts, rest)
    !> Shapes (width, n_disturbed), (n_disturbed) and (width, period).
    real(wp), intent(in) :: ends(:, :), orbit(:, :), scale(:), near
    logical, intent(in) :: ended(:)
    !> Whether starts were disturbed; whether nearby motions must come nearer then.
    logical, intent(in) :: of_starts, has_kernels
    logical, intent(out) :: attracts
    !> The largest part of a disturbance that is left; huge: not known.
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
  end subroutine judge_orbit

end module viscovib_basin_rules
