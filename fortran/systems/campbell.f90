!> Modes of a rotor over its speed: lines of a Campbell diagram, critical speeds, loss of stability.
!!
!! A mode continues the mode at the speed before with the most similar shape, x^H M y. Between two
!! speeds whose shapes differ much, modes at further speeds are computed.
module viscovib_campbell
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: polynomial_type
  use viscovib_rotor_modes, only: check_modes, find_rotor_modes, follow_mode, rotor_modes
  use viscovib_status, only: status_type
  implicit none
  private

  public :: campbell_type, critical_speed, find_campbell

  !> Similarity of shapes from which they are one mode for certain, and at least; number of times
  !! that an interval of speeds is halved.
  real(wp), parameter :: alike = 0.9_wp, similar = 0.5_wp
  integer, parameter :: halvings = 10
  !> Largest relative change of the root of a mode that is not known by its shape.
  real(wp), parameter :: change = 0.3_wp
  !> Growth that counts as 0, relative to that at an unstable speed.
  real(wp), parameter :: tiny_share = 1.0e-12_wp
  !> Iterations for a speed.
  integer, parameter :: max_turns = 100

  !> A speed (rad/s) at which the frequency of a mode is that of an order.
  type :: critical_speed
    real(wp) :: order = 0.0_wp, speed = 0.0_wp
    integer :: mode = 0
  end type critical_speed

  type :: campbell_type
    !> rad/s, and the largest real part of an eigenvalue (1/s), shape (n).
    real(wp), allocatable :: speeds(:), growth(:)
    !> Eigenvalues (1/s), NaN where a mode does not oscillate, shape (n_modes, n); shapes (n_dof,
    !! n_modes, n), NaN where they are arbitrary.
    complex(wp), allocatable :: roots(:, :), shapes(:, :, :)
    !> Sorted by order and speed.
    type(critical_speed), allocatable :: critical(:)
    !> First speed at which an eigenvalue has a positive real part (rad/s); NaN: none.
    real(wp) :: threshold = 0.0_wp
  contains
    procedure :: whirl
  end type campbell_type

  !> The modes at a speed, in the order of their lines.
  type :: lines_type
    real(wp) :: speed = 0.0_wp, growth = 0.0_wp
    logical :: is_unstable = .false.
    !> Roots and whether they exist at this speed, shape (n_modes).
    complex(wp), allocatable :: roots(:)
    logical, allocatable :: exists(:)
    !> The last shapes that were not arbitrary, their times M, and whether there are any; whether
    !! the shape is of this speed.
    complex(wp), allocatable :: shapes(:, :), weighted(:, :)
    logical, allocatable :: known(:), present(:)
  end type lines_type

contains

  subroutine find_campbell(system, speeds, orders, campbell, status)
    type(polynomial_type), intent(in) :: system
    !> Increasing (rad/s); orders of the critical speeds, > 0.
    real(wp), intent(in) :: speeds(:), orders(:)
    type(campbell_type), intent(out) :: campbell
    type(status_type), intent(out) :: status
    type(lines_type) :: lines(size(speeds))
    type(rotor_modes) :: modes
    integer :: first, i

    call check_modes(system, status)
    if (status%failed()) return
    ! Begin where no shape is arbitrary, so not at rest if modes are equal there.
    do first = 1, size(speeds)
      call find_rotor_modes(system, speeds(first), modes, status)
      if (status%failed()) return
      if (all(modes%alone)) exit
    end do
    if (first > size(speeds)) first = 1
    call find_rotor_modes(system, speeds(first), modes, status)
    if (.not. status%failed()) call begin(system, modes, lines(first))
    do i = first + 1, size(speeds)
      if (status%failed()) return
      call advance(system, lines(i - 1), speeds(i), lines(i), status)
    end do
    do i = first - 1, 1, -1
      if (status%failed()) return
      call advance(system, lines(i + 1), speeds(i), lines(i), status)
    end do
    if (status%failed()) return
    call gather(system, lines, speeds, campbell)
    allocate (campbell%critical(0))
    do i = 1, size(orders)
      call find_critical(system, lines, orders(i), campbell%critical, status)
      if (status%failed()) return
    end do
    call find_threshold(system, lines, campbell%threshold, status)
  end subroutine find_campbell

  subroutine begin(system, modes, lines)
    type(polynomial_type), intent(in) :: system
    type(rotor_modes), intent(in) :: modes
    type(lines_type), intent(out) :: lines
    integer :: i, n

    n = modes%most
    allocate (lines%roots(n), lines%exists(n), lines%known(n), lines%present(n))
    allocate (lines%shapes(system%n_dof(), n), lines%weighted(system%n_dof(), n), &
              source=(0.0_wp, 0.0_wp))
    lines%known = .false.
    call take(system, modes, [(merge(i, 0, i <= size(modes%roots)), i=1, n)], lines)
  end subroutine begin

  !> Set the lines to modes: `places` (n_modes) of the modes, 0: none.
  subroutine take(system, modes, places, lines)
    type(polynomial_type), intent(in) :: system
    type(rotor_modes), intent(in) :: modes
    integer, intent(in) :: places(:)
    type(lines_type), intent(inout) :: lines
    integer :: i

    lines%speed = modes%speed
    lines%growth = modes%growth
    lines%is_unstable = modes%is_unstable
    lines%exists = places > 0
    lines%present = .false.
    do i = 1, size(places)
      if (places(i) == 0) cycle
      lines%roots(i) = modes%roots(places(i))
      if (.not. modes%alone(places(i))) cycle
      lines%known(i) = .true.
      lines%present(i) = .true.
      lines%shapes(:, i) = modes%shapes(:, places(i))
      lines%weighted(:, i) = matmul(system%mass, lines%shapes(:, i))
    end do
  end subroutine take

  !> Continue lines to a speed.
  subroutine advance(system, from, speed, lines, status)
    type(polynomial_type), intent(in) :: system
    type(lines_type), intent(in) :: from
    !> rad/s.
    real(wp), intent(in) :: speed
    type(lines_type), intent(out) :: lines
    type(status_type), intent(out) :: status
    type(rotor_modes) :: modes
    integer :: places(size(from%roots)), turn
    real(wp) :: step
    logical :: sure

    lines = from
    step = speed - from%speed
    turn = 0
    do
      call find_rotor_modes(system, merge(speed, lines%speed + step, turn == 0), modes, status)
      if (status%failed()) return
      call match(lines, modes, places, sure)
      if (.not. sure .and. turn < halvings) then
        turn = turn + 1
        step = 0.5_wp*step
        cycle
      end if
      call take(system, modes, places, lines)
      if (.not. abs(speed - modes%speed) > 0.0_wp) return
      turn = 0
      step = speed - lines%speed
    end do
  end subroutine advance

  !> The mode of each line, 0: none.
  subroutine match(lines, modes, places, sure)
    type(lines_type), intent(in) :: lines
    type(rotor_modes), intent(in) :: modes
    integer, intent(out) :: places(:)
    !> True if the shapes leave no doubt.
    logical, intent(out) :: sure
    real(wp) :: likeness(size(places), size(modes%roots))
    logical :: free(size(modes%roots))
    integer :: at(2), i, j

    places = 0
    free = .true.
    sure = .true.
    likeness = 0.0_wp
    do j = 1, size(free)
      do i = 1, size(places)
        if (.not. (lines%known(i) .and. lines%exists(i) .and. modes%alone(j))) cycle
        likeness(i, j) = abs(dot_product(lines%weighted(:, i), modes%shapes(:, j)))
      end do
    end do
    do while (any(likeness > similar))
      at = maxloc(likeness)
      call connect(at(1), at(2))
      sure = sure .and. likeness(at(1), at(2)) > alike
      likeness(at(1), :) = 0.0_wp
      likeness(:, at(2)) = 0.0_wp
    end do
    ! Lines without a shape by the nearest root.
    likeness = 0.0_wp
    do j = 1, size(free)
      do i = 1, size(places)
        if (places(i) > 0 .or. .not. (free(j) .and. lines%exists(i))) cycle
        if (lines%known(i) .and. modes%alone(j)) sure = .false.
        likeness(i, j) = 1.0_wp - abs(modes%roots(j) - lines%roots(i)) &
                      /max(abs(modes%roots(j)), abs(lines%roots(i)))
      end do
    end do
    do while (any(likeness > 1.0_wp - change))
      at = maxloc(likeness)
      call connect(at(1), at(2))
      likeness(at(1), :) = 0.0_wp
      likeness(:, at(2)) = 0.0_wp
    end do
    ! Modes that begin to oscillate.
    do j = 1, size(free)
      if (.not. free(j)) cycle
      i = findloc(places == 0 .and. .not. lines%exists, .true., 1)
      if (i == 0) i = findloc(places, 0, 1)
      if (i > 0) call connect(i, j)
    end do

  contains

    subroutine connect(line, mode)
      integer, intent(in) :: line, mode
      places(line) = mode
      free(mode) = .false.
    end subroutine connect

  end subroutine match

  !> Lines with a mode at any speed.
  subroutine gather(system, lines, speeds, campbell)
    type(polynomial_type), intent(in) :: system
    type(lines_type), intent(in) :: lines(:)
    real(wp), intent(in) :: speeds(:)
    type(campbell_type), intent(inout) :: campbell
    complex(wp) :: none
    integer :: i, k, n

    none = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), ieee_value(0.0_wp, ieee_quiet_nan), wp)
    campbell%speeds = speeds
    campbell%growth = lines%growth
    n = 0
    do k = 1, size(lines)
      n = max(n, findloc(lines(k)%exists, .true., 1, back=.true.))
    end do
    allocate (campbell%roots(n, size(lines)), campbell%shapes(system%n_dof(), n, size(lines)), &
              source=none)
    do k = 1, size(lines)
      do i = 1, n
        if (lines(k)%exists(i)) campbell%roots(i, k) = lines(k)%roots(i)
        if (lines(k)%present(i)) campbell%shapes(:, i, k) = lines(k)%shapes(:, i)
      end do
    end do
  end subroutine gather

  !> Direction of the motion of two coordinates in the modes over the speed: 1 forward, -1 backward
  !! on a circle, 0 on a line; forward is from the first coordinate to the second. Re(x exp(i w t))
  !! goes around its ellipse with the area pi Im(x_1 conj(x_2)). NaN without motion of both.
  pure function whirl(self, plane)
    class(campbell_type), intent(in) :: self
    integer, intent(in) :: plane(2)
    real(wp) :: whirl(size(self%roots, 1), size(self%speeds))
    associate (x => self%shapes(plane(1), :, :), y => self%shapes(plane(2), :, :))
      whirl = 2.0_wp*aimag(x*conjg(y))/(abs(x)**2 + abs(y)**2)
    end associate
  end function whirl

  !> Speeds at which a frequency is `order` times the speed.
  subroutine find_critical(system, lines, order, critical, status)
    type(polynomial_type), intent(in) :: system
    type(lines_type), intent(in) :: lines(:)
    real(wp), intent(in) :: order
    type(critical_speed), allocatable, intent(inout) :: critical(:)
    type(status_type), intent(inout) :: status
    real(wp) :: ends(2), speed
    integer :: i, k

    do k = 1, size(lines) - 1
      do i = 1, size(lines(k)%roots)
        if (.not. (lines(k)%exists(i) .and. lines(k + 1)%exists(i))) cycle
        ends = [off(lines(k)), off(lines(k + 1))]
        if ((ends(1) > 0.0_wp) .eqv. (ends(2) > 0.0_wp)) cycle
        call find_zero(lines(k)%speed, lines(k + 1)%speed, ends, speed)
        if (status%failed()) return
        critical = [critical, critical_speed(order, speed, i)]
      end do
    end do

  contains

    real(wp) function off(at)
      type(lines_type), intent(in) :: at
      off = aimag(at%roots(i)) - order*at%speed
    end function off

    !> By the Illinois method, from the lines at the lower end.
    subroutine find_zero(low, high, values, middle)
      real(wp), intent(in) :: low, high, values(2)
      real(wp), intent(out) :: middle
      type(lines_type) :: there
      complex(wp) :: root
      real(wp) :: a, b, fa, fb, f
      integer :: turn
      logical :: made

      a = low
      b = high
      fa = values(1)
      fb = values(2)
      middle = b
      if (.not. abs(fb) > 0.0_wp) return
      do turn = 1, max_turns
        middle = b - fb*(b - a)/(fb - fa)
        call follow(system, lines(k:k + 1), i, middle, root, made)
        if (made) then
          f = aimag(root) - order*middle
        else
          call advance(system, lines(k), middle, there, status)
          if (status%failed() .or. .not. there%exists(i)) return
          f = off(there)
        end if
        call shrink(middle, f, a, b, fa, fb)
        if (is_small(a, b, f)) return
      end do
    end subroutine find_zero

  end subroutine find_critical

  !> The root of one line at a speed between two, if its shape leaves no doubt.
  subroutine follow(system, ends, line, speed, root, made)
    type(polynomial_type), intent(in) :: system
    type(lines_type), intent(in) :: ends(2)
    integer, intent(in) :: line
    real(wp), intent(in) :: speed
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    complex(wp) :: shape_of(system%n_dof())
    real(wp) :: part

    made = all([ends(1)%present(line), ends(2)%present(line)])
    if (.not. made) return
    part = (speed - ends(1)%speed)/(ends(2)%speed - ends(1)%speed)
    root = (1.0_wp - part)*ends(1)%roots(line) + part*ends(2)%roots(line)
    shape_of = ends(merge(1, 2, part < 0.5_wp))%shapes(:, line)
    call follow_mode(system, speed, root, shape_of, made)
    if (.not. made) return
    made = abs(dot_product(ends(1)%weighted(:, line), shape_of)) > alike &
           .and. abs(dot_product(ends(2)%weighted(:, line), shape_of)) > alike
  end subroutine follow

  !> One step of the Illinois method: b is the last point, with the other sign at a.
  pure subroutine shrink(middle, f, a, b, fa, fb)
    real(wp), intent(in) :: middle, f
    real(wp), intent(inout) :: a, b, fa, fb
    if ((f > 0.0_wp) .eqv. (fb > 0.0_wp)) then
      fa = 0.5_wp*fa
    else
      a = b
      fa = fb
    end if
    b = middle
    fb = f
  end subroutine shrink

  pure logical function is_small(a, b, f)
    real(wp), intent(in) :: a, b, f
    is_small = .not. abs(f) > 0.0_wp &
               .or. abs(b - a) <= 4.0_wp*epsilon(1.0_wp)*max(abs(a), abs(b))
  end function is_small

  !> The first speed at which a real part becomes positive.
  subroutine find_threshold(system, lines, threshold, status)
    type(polynomial_type), intent(in) :: system
    type(lines_type), intent(in) :: lines(:)
    real(wp), intent(out) :: threshold
    type(status_type), intent(inout) :: status
    type(rotor_modes) :: modes
    real(wp) :: a, b, fa, fb, f, lifted
    integer :: k, turn

    threshold = ieee_value(0.0_wp, ieee_quiet_nan)
    k = findloc(lines%is_unstable, .true., 1)
    if (k == 0) return
    threshold = lines(k)%speed
    if (k == 1) return
    a = lines(k - 1)%speed
    b = lines(k)%speed
    ! Rounding errors may be positive.
    lifted = 0.0_wp
    if (.not. lines(k - 1)%growth < 0.0_wp) then
      lifted = 2.0_wp*lines(k - 1)%growth + tiny_share*lines(k)%growth
    end if
    fa = lines(k - 1)%growth - lifted
    fb = lines(k)%growth - lifted
    do turn = 1, max_turns
      if (.not. (fa < 0.0_wp .and. fb > 0.0_wp .or. fa > 0.0_wp .and. fb < 0.0_wp)) return
      threshold = b - fb*(b - a)/(fb - fa)
      call find_rotor_modes(system, threshold, modes, status)
      if (status%failed()) return
      f = modes%growth - lifted
      call shrink(threshold, f, a, b, fa, fb)
      if (is_small(a, b, f) .or. ieee_is_nan(f)) return
    end do
  end subroutine find_threshold

end module viscovib_campbell
