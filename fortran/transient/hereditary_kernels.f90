! Optimize: -O3
!> The inner loops of a step with memory, over arrays of explicit shape.
module viscovib_hereditary_kernels
  use viscovib_hereditary_maps, only: row_block
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_any, add_columns, add_held, add_up, carry_on, compare, copy
  public :: gather_channels, check_resolution, runs_away
  public :: product_of

  !> Largest last Legendre coefficient of a resolved step, relative to the
  !! displacement.
  real(wp), parameter :: unresolved = 1.0e-2_wp

contains

  !> Add the memory of the displacement held before the start to the memory since then.
  pure subroutine add_held(n, held, remembered)
    integer, intent(in) :: n
    real(wp), intent(in) :: held(n)
    real(wp), intent(inout) :: remembered(n)
    remembered = remembered + held
  end subroutine add_held

  !> Channels at the points of a step, less the held value.
  pure subroutine gather_channels(n_points, n_dof, n_bent, n_channels, points, y_start, y, gather, &
                                  gather_bends, held, g)
    integer, intent(in) :: n_points, n_dof, n_bent, n_channels
    real(wp), intent(in) :: points(n_points, n_dof), y_start(n_bent), y(n_points - 1, n_bent)
    real(wp), intent(in) :: gather(n_channels, n_dof), gather_bends(n_channels, n_bent)
    real(wp), intent(in) :: held(n_channels)
    real(wp), intent(out) :: g(n_points, n_channels)
    integer :: c, d

    do c = 1, n_channels
      g(:, c) = -held(c)
      do d = 1, n_dof
        g(:, c) = g(:, c) + gather(c, d)*points(:, d)
      end do
      do d = 1, n_bent
        g(1, c) = g(1, c) + gather_bends(c, d)*y_start(d)
        g(2:, c) = g(2:, c) + gather_bends(c, d)*y(:, d)
      end do
    end do
  end subroutine gather_channels

  !> Update the largest last coefficient and displacement of all steps.
  pure subroutine check_resolution(n, points, last_coefficient, roughness, largest)
    integer, intent(in) :: n
    real(wp), intent(in) :: points(n), last_coefficient(n)
    real(wp), intent(inout) :: roughness, largest
    roughness = max(roughness, abs(sum(last_coefficient*points)))
    largest = max(largest, abs(points(n)))
  end subroutine check_resolution

  !> Compensated sum.
  elemental subroutine add_up(total, rest, increment)
    real(wp), intent(inout) :: total, rest
    real(wp), intent(in) :: increment
    real(wp) :: part, sum
    part = increment + rest
    sum = total + part
    rest = part - (sum - total)
    total = sum
  end subroutine add_up


  !> As `add_up`, for any relative size of the arguments.
  elemental subroutine add_any(total, rest, increment)
    real(wp), intent(inout) :: total, rest
    real(wp), intent(in) :: increment
    real(wp) :: part, sum, back
    part = increment + rest
    sum = total + part
    back = sum - total
    rest = (total - (sum - back)) + (part - back)
    total = sum
  end subroutine add_any

  !> The next start is the last end, and the next points are extrapolated.
  pure subroutine carry_on(n, of_start, of_points, start, y)
    integer, intent(in) :: n
    real(wp), intent(in) :: of_start(n), of_points(n, n)
    real(wp), intent(inout) :: start, y(n)
    real(wp) :: ahead(9)
    integer :: k

    ahead(:n) = of_start*start
    do k = 1, n
      ahead(:n) = ahead(:n) + of_points(:, k)*y(k)
    end do
    start = y(n)
    y = ahead(:n)
  end subroutine carry_on

  !> Largest change and size of whole registers; NaN if any entry is NaN.
  pure subroutine compare(n, x, next, change, size_of)
    integer, intent(in) :: n
    real(wp), dimension(row_block, n/row_block), intent(in) :: x, next
    real(wp), intent(out) :: change, size_of
    real(wp), dimension(row_block) :: largest, moved, poison, shift
    integer :: b

    largest = abs(next(:, 1))
    moved = abs(next(:, 1) - x(:, 1))
    poison = 0.0_wp*moved
    !GCC$ novector
    do b = 2, n/row_block
      shift = abs(next(:, b) - x(:, b))
      moved = larger(moved, shift)
      largest = larger(largest, abs(next(:, b)))
      ! A NaN would be lost in a comparison, but not in a sum.
      poison = poison + 0.0_wp*shift
    end do
    size_of = largest_of(largest)
    change = largest_of(moved) + sum(poison)
  end subroutine compare

  !> Largest of the lanes, in pairs: `maxval` compares them one by one.
  pure real(wp) function largest_of(x)
    real(wp), intent(in) :: x(row_block)
    real(wp) :: quarter(row_block/2)
    quarter = larger(x(:row_block/2), x(row_block/2 + 1:))
    largest_of = larger(larger(quarter(1), quarter(3)), larger(quarter(2), quarter(4)))
  end function largest_of

  elemental real(wp) function larger(a, b)
    real(wp), intent(in) :: a, b
    larger = merge(a, b, a > b)
  end function larger

  pure subroutine copy(n, from, to)
    integer, intent(in) :: n
    real(wp), intent(in) :: from(n)
    real(wp), intent(out) :: to(n)
    to = from
  end subroutine copy

  pure subroutine add_columns(n, m, start, shift, total)
    integer, intent(in) :: n, m
    real(wp), intent(in) :: start(m), shift(n, m)
    real(wp), intent(out) :: total(n, m)
    integer :: d
    do d = 1, m
      total(:, d) = start(d) + shift(:, d)
    end do
  end subroutine add_columns

  !> out = start + matrix x. Whole registers are loaded at once if the compiler knows the first
  !! extent and sums do not begin at 0.
  pure subroutine product_of(n_rows, n, matrix, x, start, out)
    integer, intent(in) :: n_rows, n
    real(wp), intent(in) :: matrix(row_block, n_rows/row_block, n), x(n)
    real(wp), intent(in) :: start(row_block, n_rows/row_block)
    real(wp), intent(out) :: out(row_block, n_rows/row_block)
    real(wp) :: even(row_block), odd(row_block)
    integer :: b, c

    do b = 1, n_rows/row_block
      if (n < 2) then
        out(:, b) = start(:, b)
        if (n == 1) out(:, b) = out(:, b) + matrix(:, b, 1)*x(1)
        cycle
      end if
      even = start(:, b) + matrix(:, b, 1)*x(1)
      odd = matrix(:, b, 2)*x(2)
      !GCC$ novector
      do c = 2, n/2
        even = even + matrix(:, b, 2*c - 1)*x(2*c - 1)
        odd = odd + matrix(:, b, 2*c)*x(2*c)
      end do
      if (mod(n, 2) == 1) even = even + matrix(:, b, n)*x(n)
      out(:, b) = even + odd
    end do
  end subroutine product_of

  !> True if a coordinate, larger than before, grows faster than the step is long, and the
  !! step does not resolve it: its polynomial may pass an escape to infinity.
  pure logical function runs_away(s, h, u, v, largest, x, last_coefficient)
    integer, intent(in) :: s
    real(wp), intent(in) :: h, u(:), v(:), largest(:), x(:), last_coefficient(:)
    real(wp) :: points(s + 2), size_of
    logical :: grows, released
    integer :: d
    runs_away = .false.
    do d = 1, size(u)
      ! Released at rest, as in the first step.
      released = .not. (abs(v(d)) > 0.0_wp .or. largest(d) > 0.0_wp)
      grows = u(d)*v(d) > 0.0_wp .and. h*abs(v(d)) > 0.5_wp*abs(u(d)) &
              .and. abs(u(d)) > 0.7_wp*largest(d)
      if (.not. (grows .or. released)) cycle
      points(1) = u(d)
      points(2:) = u(d) + x((d - 1)*(s + 1) + 1:d*(s + 1))
      size_of = maxval(abs(points))
      if (released) grows = abs(u(d)) > 0.0_wp .and. size_of > 1.5_wp*abs(u(d))
      if (.not. grows) cycle
      runs_away = runs_away .or. abs(dot_product(last_coefficient, points)) > unresolved*size_of
    end do
  end function runs_away

end module viscovib_hereditary_kernels
