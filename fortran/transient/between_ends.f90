! Optimize: -O3
!> States between the ends of equal steps of a smooth motion without memory.
!!
!! In each step they follow the polynomial of degree 23 through displacement, velocity and
!! acceleration at the four nearest ends of steps on each side, which the steps know to their full
!! order. Its accelerations in the middle of the step differ from those of the equations by a
!! residual, which shows its error: both are proportional to product_j (x - x_j)^3 and its second
!! derivative.
module viscovib_between_ends
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: fill_between, beyond

  !> Ends of a polynomial, and the number of these before the step and after it.
  integer, parameter :: n_ends = 8, beyond = 3
  !> Middle of the step; safety factor of the error.
  real(wp), parameter :: middle = beyond + 0.5_wp, safety = 2.0_wp
  !> Number of positions for the largest values of the error.
  integer, parameter :: n_places = 32

contains

  !> States in each step at equal distances, and their errors.
  subroutine fill_between(system, h, states, per, allowed, more, off)
    class(driven_system_type), intent(in) :: system
    !> Length of a step; the number of parts of each.
    real(wp), intent(in) :: h
    integer, intent(in) :: per
    !> (q_1, v_1, ...) at the ends of m steps from time 0 on, and of `beyond` steps before them and
    !! after them, shape (2 n_dof, -beyond:m + beyond); the largest error of each row.
    real(wp), intent(in) :: states(:, -beyond:), allowed(:)
    !> Shape (2 n_dof, m per + 1); not found if an error is too large.
    real(wp), intent(out) :: more(:, :)
    !> Largest error of each row.
    real(wp), intent(out) :: off(:)
    real(wp), allocatable :: known(:, :, :)
    integer :: m

    m = ubound(states, 2) - beyond
    call know_ends(system, h, states, known)
    call find_errors(system, h, known, off)
    if (.not. all(off <= allowed)) return
    more(:, ::per) = states(:, 0:m)
    if (counting) call count_up(counted_states, m*(per - 1))
    call fill_steps(h, known, per, more)
  end subroutine fill_between

  !> Displacements, velocities and accelerations at the ends, in units of steps, shape
  !! (-beyond:m + beyond, 0:2, n).
  subroutine know_ends(system, h, states, known)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h, states(:, -beyond:)
    real(wp), allocatable, intent(out) :: known(:, :, :)
    integer :: d, i, last, n

    n = size(states, 1)/2
    last = ubound(states, 2)
    allocate (known(-beyond:last, 0:2, n))
    do d = 1, n
      known(:, 0, d) = states(2*d - 1, :)
      known(:, 1, d) = states(2*d, :)
    end do
    call accelerate(system, [(i*h, i=-beyond, last)], known(:, 0, :), known(:, 1, :), &
                    known(:, 2, :))
    known(:, 1, :) = h*known(:, 1, :)
    known(:, 2, :) = h**2*known(:, 2, :)
  end subroutine know_ends

  !> Accelerations at states, shapes (k) and (k, n).
  subroutine accelerate(system, t, q, v, a)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: a(:, :)
    real(wp) :: drive(size(t), size(system%drives))
    real(wp), dimension(n_lanes, size(q, 2)) :: some_q, some_v, some_a
    integer :: first, i, last, places(n_lanes)

    drive = system%drive_at(t)
    do first = 1, size(t), n_lanes
      ! Lanes beyond the last state repeat it.
      last = min(first + n_lanes - 1, size(t))
      places = [(min(first + i, last), i=0, n_lanes - 1)]
      some_q = q(places, :)
      some_v = v(places, :)
      call system%acceleration(some_q, some_v, drive(places, :), some_a)
      a(first:last, :) = some_a(:last - first + 1, :)
    end do
  end subroutine accelerate

  !> The states inside the steps.
  subroutine fill_steps(h, known, per, more)
    real(wp), intent(in) :: h
    real(wp), intent(in), contiguous :: known(:, 0:, :)
    integer, intent(in) :: per
    real(wp), intent(inout) :: more(:, :)
    real(wp) :: values(size(known, 1) - n_ends + 1), weights(n_ends, 0:2, 0:2)
    integer :: d, p

    do p = 1, per - 1
      call weigh(beyond + real(p, wp)/real(per, wp), weights)
      do d = 1, size(known, 3)
        call join(known(:, :, d), weights(:, :, 0), values)
        more(2*d - 1, p + 1::per) = values
        call join(known(:, :, d), weights(:, :, 1), values)
        more(2*d, p + 1::per) = values/h
      end do
    end do
  end subroutine fill_steps

  !> Largest error of each row, from the residuals in the middle of the steps.
  subroutine find_errors(system, h, known, off)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h
    real(wp), intent(in), contiguous :: known(:, 0:, :)
    real(wp), intent(out) :: off(:)
    real(wp), dimension(size(known, 1) - n_ends + 1, size(known, 3)) :: q, v, a, right
    real(wp) :: weights(n_ends, 0:2, 0:2), of_residual(2), residual
    integer :: d, k

    call measure(of_residual)
    call weigh(middle, weights)
    do d = 1, size(known, 3)
      call join(known(:, :, d), weights(:, :, 0), q(:, d))
      call join(known(:, :, d), weights(:, :, 1), v(:, d))
      call join(known(:, :, d), weights(:, :, 2), a(:, d))
    end do
    call accelerate(system, [((k - 0.5_wp)*h, k=1, size(q, 1))], q, v/h, right)
    do d = 1, size(known, 3)
      residual = safety*maxval(abs(a(:, d) - h**2*right(:, d)))
      off(2*d - 1) = of_residual(1)*residual
      off(2*d) = of_residual(2)*residual/h
    end do
  end subroutine find_errors

  !> Sums of known values by weights, for the polynomial of each step.
  pure subroutine join(known, weights, values)
    real(wp), intent(in), contiguous :: known(:, 0:)
    real(wp), intent(in) :: weights(n_ends, 0:2)
    real(wp), intent(out), contiguous :: values(:)
    integer :: j, k
    values = 0.0_wp
    do j = 0, 2
      associate (w => weights(:, j))
        do k = 1, size(values)
          values(k) = values(k) + (w(1)*known(k, j) + w(2)*known(k + 1, j) + w(3)*known(k + 2, j) &
                                   + w(4)*known(k + 3, j) + w(5)*known(k + 4, j) &
                                   + w(6)*known(k + 5, j) + w(7)*known(k + 6, j) &
                                   + w(8)*known(k + 7, j))
        end do
      end associate
    end do
  end subroutine join

  !> Weights of value, first and second derivative at each end (n_ends, 0:2) for the value and the
  !! first two derivatives of the polynomial at x, which is no end. With the Lagrange polynomial
  !! l_i, s = x - x_i and l_i^-3 = 1 + g_1 s + g_2 s^2 + ..., those of end i are
  !! l_i^3 (1 + g_1 s + g_2 s^2), l_i^3 (s + g_1 s^2) and l_i^3 s^2/2.
  pure subroutine weigh(x, weights)
    real(wp), intent(in) :: x
    !> The last index is the derivative.
    real(wp), intent(out) :: weights(n_ends, 0:2, 0:2)
    real(wp) :: cube(0:2), factor(0:2, 0:2), g(2), l, s, sums(2), sums_here(2)
    integer :: i, j

    do i = 1, n_ends
      l = 1.0_wp
      sums = 0.0_wp
      sums_here = 0.0_wp
      do j = 1, n_ends
        if (j == i) cycle
        l = l*(x - (j - 1))/(i - j)
        sums = sums + [1.0_wp/(i - j), 1.0_wp/(i - j)**2]
        sums_here = sums_here + [1.0_wp/(x - (j - 1)), 1.0_wp/(x - (j - 1))**2]
      end do
      g = [-3.0_wp*sums(1), 4.5_wp*sums(1)**2 + 1.5_wp*sums(2)]
      cube = l**3*[1.0_wp, 3.0_wp*sums_here(1), 9.0_wp*sums_here(1)**2 - 3.0_wp*sums_here(2)]
      s = x - (i - 1)
      factor(:, 0) = [1.0_wp + (g(1) + g(2)*s)*s, g(1) + 2.0_wp*g(2)*s, 2.0_wp*g(2)]
      factor(:, 1) = [(1.0_wp + g(1)*s)*s, 1.0_wp + 2.0_wp*g(1)*s, 2.0_wp*g(1)]
      factor(:, 2) = [0.5_wp*s**2, s, 1.0_wp]
      do j = 0, 2
        weights(i, j, 0) = cube(0)*factor(0, j)
        weights(i, j, 1) = cube(1)*factor(0, j) + cube(0)*factor(1, j)
        weights(i, j, 2) = cube(2)*factor(0, j) + 2.0_wp*cube(1)*factor(1, j) &
                           + cube(0)*factor(2, j)
      end do
    end do
  end subroutine weigh

  !> Largest errors of value and first derivative in a step, relative to the residual in its middle.
  pure subroutine measure(of_residual)
    real(wp), intent(out) :: of_residual(2)
    real(wp) :: errors(0:2)
    integer :: p
    of_residual = 0.0_wp
    do p = 1, n_places - 1
      errors = error_at(beyond + real(p, wp)/real(n_places, wp))
      of_residual = max(of_residual, abs(errors(0:1)))
    end do
    errors = error_at(middle)
    of_residual = of_residual/abs(errors(2))
  end subroutine measure

  !> product_j (x - x_j)^3 and its first two derivatives.
  pure function error_at(x) result(errors)
    real(wp), intent(in) :: x
    real(wp) :: errors(0:2)
    real(wp) :: sums(2)
    integer :: j
    errors = 1.0_wp
    sums = 0.0_wp
    do j = 0, n_ends - 1
      errors = errors*(x - j)**3
      sums = sums + [1.0_wp/(x - j), 1.0_wp/(x - j)**2]
    end do
    errors(1) = errors(1)*3.0_wp*sums(1)
    errors(2) = errors(2)*(9.0_wp*sums(1)**2 - 3.0_wp*sums(2))
  end function error_at

end module viscovib_between_ends
