!> Branches of periodic motions along a parameter p: solutions of P(y, p) = y, where P is the map
!! of a period (viscovib_period_map), with a fixed number of steps.
!!
!! Points are z = (y, p), in units of the size of the first motion and of the range of p.
module viscovib_motion_path
  use viscovib_dense, only: factorize, solve_columns
  use viscovib_kinds, only: i8, wp
  use viscovib_motion_extremes, only: find_extremes, timed_motion
  use viscovib_orbit_multipliers, only: multipliers_of
  use viscovib_period_map, only: period_map, period_run
  use viscovib_pseudo_inverse, only: null_vector, sign_of_determinant
  use viscovib_shooting, only: n_shown
  use viscovib_status, only: show
  implicit none
  private

  public :: difference, map_family, map_motion, motion_path, motion_point, plain_family

  !> Relative step of differences by the parameter; correction below which the derivative by the
  !! parameter is kept.
  real(wp), parameter :: difference = 1.0e-6_wp, settled = 1.0e-7_wp
  !> Relative change of differences to both sides above which their distance is reduced by this
  !! factor, and the smallest distance.
  real(wp), parameter :: straight = 1.0e-2_wp, nearer = 1.0_wp/32.0_wp, nearest = 5.0e-13_wp
  !> Distances after a corner at which its other side is searched, and of the motions on that side.
  real(wp), parameter :: behind(4) = [1.0e-8_wp, 1.0e-7_wp, 1.0e-6_wp, 1.0e-5_wp], &
                         on(5) = [1.0e-7_wp, 1.0e-6_wp, 1.0e-5_wp, 1.0e-4_wp, 1.0e-3_wp]
  !> Relative error of extremes.
  real(wp), parameter :: extreme_error = 1.0e-9_wp
  integer, parameter :: max_iterations = 8

  !> The maps along a parameter.
  type, abstract :: map_family
  contains
    procedure(map_interface), deferred :: map_at
  end type map_family

  abstract interface
    !> The map at p, valid until the next call; `made` is false if there is none.
    subroutine map_interface(self, p, map, made)
      import :: map_family, period_map, wp
      class(map_family), intent(inout), target :: self
      real(wp), intent(in) :: p
      type(period_map), intent(out) :: map
      logical, intent(out) :: made
    end subroutine map_interface
  end interface

  !> Along the frequency of the load, or along the factor of the load.
  type, extends(map_family) :: plain_family
    type(period_map) :: map
    logical :: is_frequency = .true.
  contains
    procedure :: map_at => plain_map
  end type plain_family

  !> The motion of a map from a state.
  type, extends(timed_motion) :: map_motion
    type(period_map) :: map
    real(wp), allocatable :: state(:)
    integer(i8) :: n_steps = 1
  contains
    procedure :: states => states_of_map
  end type map_motion

  type :: motion_point
    real(wp), allocatable :: z(:), tangent(:)
    !> Derivatives of P(y, p) - y by z, in units of z, and of P by y.
    real(wp), allocatable :: slopes(:, :), by_start(:, :)
    integer :: n_passed = 0, iterations = 0
    real(wp) :: correction = 0.0_wp
  contains
    procedure :: multipliers
    procedure :: bordered
    procedure :: orientation
  end type motion_point

  type :: motion_path
    class(map_family), pointer :: family => null()
    real(wp) :: start = 0.0_wp, finish = 1.0_wp
    integer(i8) :: n_steps = 1
    !> The size of the first motion, and the allowed error of states.
    real(wp) :: size = 1.0_wp, tolerance = 0.0_wp
    !> Units of z.
    real(wp), allocatable :: units(:)
  contains
    procedure :: set_units
    procedure :: parameter_of
    procedure :: state_of
    procedure :: run_at
    procedure :: correct
    procedure :: between
    procedure :: round_corner
    procedure :: switches_ahead
    procedure :: extremes
    procedure :: find_slopes
    procedure, private :: by_parameter
  end type motion_path

contains

  subroutine plain_map(self, p, map, made)
    class(plain_family), intent(inout), target :: self
    real(wp), intent(in) :: p
    type(period_map), intent(out) :: map
    logical, intent(out) :: made
    map = self%map
    made = .true.
    if (self%is_frequency) then
      made = p > 0.0_wp
      map%nu = p
    else
      call map%load%scale(p)
    end if
  end subroutine plain_map

  subroutine states_of_map(self, t, states)
    class(map_motion), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), allocatable, intent(out) :: states(:, :)
    type(period_run) :: ran
    call self%map%run(self%state, self%n_steps, ran, t, derivatives=.false.)
    allocate (states, source=ran%at_times(:, :ran%n_reached))
  end subroutine states_of_map

  !> Floquet multipliers, the largest first.
  function multipliers(self)
    class(motion_point), intent(in) :: self
    complex(wp) :: multipliers(size(self%z) - 1)
    call multipliers_of(self%by_start, multipliers)
  end function multipliers

  !> The derivatives and the tangent as a square matrix.
  pure function bordered(self) result(matrix)
    class(motion_point), intent(in) :: self
    real(wp) :: matrix(size(self%z), size(self%z))
    matrix(:size(self%z) - 1, :) = self%slopes
    matrix(size(self%z), :) = self%tangent
  end function bordered

  !> The sign of the determinant of `bordered`: it changes at branch points only.
  pure real(wp) function orientation(self)
    class(motion_point), intent(in) :: self
    orientation = sign_of_determinant(self%bordered())
  end function orientation

  !> Set the units from the map at the beginning and the size of its motion.
  subroutine set_units(self, map)
    class(motion_path), intent(inout) :: self
    type(period_map), intent(in) :: map
    self%units = [self%size/map%weights(), abs(self%finish - self%start)]
  end subroutine set_units

  pure real(wp) function parameter_of(self, z)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: z(:)
    parameter_of = z(size(z))*self%units(size(z))
  end function parameter_of

  pure function state_of(self, z) result(state)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: z(:)
    real(wp) :: state(size(z) - 1)
    state = z(:size(z) - 1)*self%units(:size(z) - 1)
  end function state_of

  !> A motion over the period from a state at p.
  subroutine run_at(self, state, p, ran, derivatives)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: state(:), p
    type(period_run), intent(out) :: ran
    logical, intent(in) :: derivatives
    type(period_map) :: map
    logical :: made

    call self%family%map_at(p, map, made)
    if (made) then
      call map%run(state, self%n_steps, ran, derivatives=derivatives)
    else
      ran%known = .false.
    end if
  end subroutine run_at

  !> The map at z and its derivatives in units of z. The derivative by the parameter is computed
  !! with an adapted step of differences, or kept.
  subroutine find_slopes(self, z, keep, by_p, distance, ran, slopes, found)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: z(:)
    !> True to keep the derivative by the parameter.
    logical, intent(in) :: keep
    real(wp), allocatable, intent(inout) :: by_p(:)
    real(wp), intent(inout) :: distance
    type(period_run), intent(out) :: ran
    real(wp), allocatable, intent(out) :: slopes(:, :)
    logical, intent(out) :: found
    real(wp) :: y(size(z) - 1), p
    integer :: i, n

    n = size(y)
    y = self%state_of(z)
    p = self%parameter_of(z)
    call self%run_at(y, p, ran, .true.)
    found = ran%is_complete()
    if (.not. found) return
    if (.not. keep) call self%by_parameter(y, p, ran%last, distance, by_p, found)
    if (.not. found) return
    associate (units => self%units(:n))
      allocate (slopes(n, n + 1))
      slopes(:, :n) = ran%by_start
      do i = 1, n
        slopes(i, i) = slopes(i, i) - 1.0_wp
      end do
      slopes(:, :n) = slopes(:, :n)*spread(units, 1, n)/spread(units, 2, n)
      slopes(:, n + 1) = by_p*self%units(n + 1)/units
    end associate
  end subroutine find_slopes

  !> The derivative of the end of a motion by the parameter, by differences.
  !!
  !! Derivatives grow like the square root of the penetration of a law: near grazing,
  !! differences across it are wrong on both sides.
  subroutine by_parameter(self, y, p, here, distance, by_p, found)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: y(:), p, here(:)
    real(wp), intent(inout) :: distance
    real(wp), allocatable, intent(inout) :: by_p(:)
    logical, intent(out) :: found
    type(period_run) :: left, right
    real(wp) :: h, bend
    integer :: n

    n = size(y)
    do
      h = distance*max(abs(p), self%units(n + 1))
      call self%run_at(y, p - h, left, .false.)
      call self%run_at(y, p + h, right, .false.)
      found = left%is_complete() .and. right%is_complete()
      if (.not. found) return
      associate (units => self%units(:n))
        by_p = right%last - left%last
        bend = maxval(abs((right%last - 2.0_wp*here + left%last)/units))
        found = bend <= straight*maxval(abs(by_p/units)) .or. distance*nearer < nearest
      end associate
      by_p = by_p/(2.0_wp*h)
      if (found) return
      distance = distance*nearer
    end do
  end subroutine by_parameter

  !> Correct a guess in the plane across a direction; `found` is false if Newton's method fails.
  subroutine correct(self, guess, along, point, found)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: guess(:), along(:)
    type(motion_point), intent(out) :: point
    logical, intent(out) :: found
    type(period_run) :: ran
    real(wp), allocatable :: by_p(:)
    real(wp) :: matrix(size(guess), size(guess)), both(size(guess), 2), before, distance
    integer :: n, pivots(size(guess)), turn
    logical :: singular

    n = size(guess) - 1
    allocate (point%z, source=guess)
    before = 0.25_wp*huge(before)
    distance = difference
    do turn = 1, max_iterations
      ! So near to convergence the derivative by the parameter no longer changes.
      call self%find_slopes(point%z, turn > 1 .and. distance >= difference &
                            .and. before <= settled, by_p, distance, ran, point%slopes, found)
      if (.not. found) return
      matrix(:n, :) = point%slopes
      matrix(n + 1, :) = along
      both(:n, 1) = point%z(:n) - ran%last/self%units(:n)
      both(n + 1, 1) = -dot_product(along, point%z - guess)
      both(:, 2) = 0.0_wp
      both(n + 1, 2) = 1.0_wp
      call factorize(n + 1, matrix, pivots, singular)
      found = .not. singular
      if (singular) return
      call solve_columns(n + 1, 2, matrix, pivots, both)
      point%correction = maxval(abs(both(:, 1)))
      found = point%correction <= max(2.0_wp*before, 1.0_wp) .and. all(abs(both) <= huge(1.0_wp))
      if (.not. found) return
      point%z = point%z + both(:, 1)
      if (point%correction <= 1.0e-3_wp*self%tolerance/self%size &
          .or. (point%correction <= 1.0e-11_wp .and. point%correction > 0.3_wp*before)) then
        point%tangent = both(:, 2)/norm2(both(:, 2))
        point%by_start = ran%by_start
        point%n_passed = ran%n_passed
        point%iterations = turn
        return
      end if
      before = point%correction
    end do
    found = .false.
  end subroutine correct

  !> A point on the chord between two points.
  subroutine between(self, one, other, part, point, found)
    class(motion_path), intent(in) :: self
    type(motion_point), intent(in) :: one, other
    real(wp), intent(in) :: part
    type(motion_point), intent(out) :: point
    logical, intent(out) :: found
    real(wp) :: chord(size(one%z))
    chord = other%z - one%z
    call self%correct(one%z + part*chord, chord/norm2(chord), point, found)
  end subroutine between

  !> The next point after a corner of the branch, for example where an impact begins.
  !!
  !! After it the branch continues in the null direction of the derivatives of the other side. The
  !! sign of the determinant, which is constant, distinguishes forwards and backwards.
  subroutine round_corner(self, here, next, found)
    class(motion_path), intent(in) :: self
    type(motion_point), intent(in) :: here
    type(motion_point), intent(out) :: next
    logical, intent(out) :: found
    type(motion_point) :: side
    type(period_run) :: ran
    real(wp), allocatable :: by_p(:)
    real(wp) :: distance
    integer :: i, k

    do i = 1, size(behind)
      side%z = here%z + behind(i)*here%tangent
      distance = difference
      call self%find_slopes(side%z, .false., by_p, distance, ran, side%slopes, found)
      if (found) found = ran%n_passed /= here%n_passed
      if (.not. found) cycle
      call null_vector(side%slopes, side%tangent)
      side%tangent = side%tangent*side%orientation()*here%orientation()
      do k = 1, size(on)
        call self%correct(here%z + on(k)*side%tangent, side%tangent, next, found)
        if (found) found = next%n_passed == ran%n_passed
        if (found) return
      end do
    end do
    found = .false.
  end subroutine round_corner

  !> A clause of a message: whether the number of switches is different near a point.
  function switches_ahead(self, here) result(text)
    class(motion_path), intent(in) :: self
    type(motion_point), intent(in) :: here
    character(len=:), allocatable :: text
    type(period_run) :: ran
    real(wp) :: z(size(here%z))
    integer :: i

    text = ''
    do i = 1, size(behind)
      z = here%z + behind(i)*here%tangent
      call self%run_at(self%state_of(z), self%parameter_of(z), ran, .true.)
      if (ran%known .and. ran%n_passed == here%n_passed) cycle
      text = '; near it laws switch '//show(ran%n_passed)//' times instead of ' &
             //show(here%n_passed)//', as at a grazing contact'
      return
    end do
  end function switches_ahead

  !> Smallest and largest displacements of the motion at a point.
  subroutine extremes(self, z, low, high)
    class(motion_path), intent(in) :: self
    real(wp), intent(in) :: z(:)
    real(wp), allocatable, intent(out) :: low(:), high(:)
    type(map_motion) :: motion
    real(wp), allocatable :: t(:)
    integer :: i, n
    logical :: made

    call self%family%map_at(self%parameter_of(z), motion%map, made)
    motion%state = self%state_of(z)
    motion%n_steps = self%n_steps
    n = int(max(int(n_shown, i8), self%n_steps))
    allocate (t, source=[(i*(motion%map%period()/n), i=0, n)])
    t(n + 1) = motion%map%period()
    call find_extremes(motion, t, extreme_error, low, high)
  end subroutine extremes

end module viscovib_motion_path
