! Optimize: -O2 -fvect-cost-model=dynamic
!> Real roots of the characteristic equation: zeros along the real axis of the eigenvalues of D(s)
!! if D is symmetric, otherwise of its determinant.
module viscovib_real_roots
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_characteristic_matrix, only: characteristic_matrix
  use viscovib_kinds, only: wp
  use viscovib_sorting, only: sort_reals
  use viscovib_stopping, only: given_up
  use viscovib_symmetric_modes, only: symmetric_values
  implicit none
  private

  public :: find_real_roots

  !> Points to the right of 0, between two fractions of the fastest rate; points to the left.
  integer, parameter :: n_right = 1200, n_left = 600
  real(wp), parameter :: first_part = 1.0e-12_wp, last_part = 1.0e3_wp
  !> Relative tolerance of roots; roots closer to 0 than this fraction of the cut are 0.
  real(wp), parameter :: close_enough = 1.0e-15_wp, at_zero = 4.0e-16_wp
  integer, parameter :: most_steps = 200, most_sections = 60

contains

  !> Real roots, largest first: those right of the branch cut, or of 0 without a cut.
  subroutine find_real_roots(matrix, roots, cancel)
    type(characteristic_matrix), intent(in) :: matrix
    real(wp), allocatable, intent(out) :: roots(:)
    integer(c_int), intent(inout), optional :: cancel
    real(wp), allocatable :: grid(:), values(:, :)
    integer :: i, j

    call make_grid(matrix, grid)
    allocate (values(merge(matrix%n_dof(), 1, matrix%is_symmetric), size(grid)))
    allocate (roots(0))
    do i = 1, size(grid), 64
      if (given_up(cancel)) return
      associate (last => min(i + 63, size(grid)))
        call evaluate(matrix, grid(i:last), values(:, i:last))
      end associate
    end do
    do j = 1, size(values, 1)
      do i = 1, size(grid) - 1
        if (differ(values(j, i), values(j, i + 1))) then
          call add_between(matrix, j, grid(i:i + 1), values(j, i:i + 1), roots)
        else if (i > 1) then
          ! Between two close roots the extreme value has another sign.
          if (is_dip(values(j, i - 1:i + 1))) then
            call add_pair(matrix, j, grid(i - 1:i + 1), values(j, i - 1:i + 1), roots)
          end if
        end if
      end do
    end do
    call sort_reals(roots)
    roots = roots(size(roots):1:-1)
  end subroutine find_real_roots

  pure logical function differ(a, b)
    real(wp), intent(in) :: a, b
    differ = (a < 0.0_wp .and. b > 0.0_wp) .or. (a > 0.0_wp .and. b < 0.0_wp)
  end function differ

  pure logical function is_dip(v)
    real(wp), intent(in) :: v(3)
    is_dip = abs(v(2)) < abs(v(1)) .and. abs(v(2)) < abs(v(3)) &
             .and. (all(v > 0.0_wp) .or. all(v < 0.0_wp))
  end function is_dip

  !> Grid, ascending.
  pure subroutine make_grid(matrix, grid)
    type(characteristic_matrix), intent(in) :: matrix
    real(wp), allocatable, intent(out) :: grid(:)
    integer :: i, n

    n = merge(n_left, 0, matrix%cut > 0.0_wp)
    allocate (grid(n + n_right))
    do i = 1, n
      grid(i) = -matrix%cut*(1.0_wp - 10.0_wp**(-10.0_wp*(n - i + 1)/n))
    end do
    do i = 1, n_right
      grid(n + i) = matrix%fastest*first_part &
                    *(last_part/first_part)**(real(i - 1, wp)/(n_right - 1))
    end do
  end subroutine make_grid

  !> Eigenvalues of D at each s, or one number with the sign and magnitude of its determinant.
  subroutine evaluate(matrix, s, values)
    type(characteristic_matrix), intent(in) :: matrix
    real(wp), intent(in) :: s(:)
    !> Shape (n, size(s)).
    real(wp), intent(out) :: values(:, :)
    complex(wp) :: kept(size(matrix%kernels), size(s)), d(matrix%n_dof(), matrix%n_dof())
    complex(wp) :: determinant(size(s))
    integer :: k, power(size(s))

    if (matrix%is_symmetric) then
      call matrix%retained(cmplx(s, 0.0_wp, wp), (1.0_wp, 0.0_wp), kept)
      do k = 1, size(s)
        call matrix%at(cmplx(s(k), 0.0_wp, wp), cmplx(real(kept(:, k)), 0.0_wp, wp), d)
        call symmetric_values(real(d), values(:, k))
      end do
    else
      call matrix%determinants(cmplx(s, 0.0_wp, wp), (1.0_wp, 0.0_wp), determinant, power)
      values(1, :) = scale(real(determinant), max(min(power, 900), -900))
    end if
  end subroutine evaluate

  real(wp) function value_at(matrix, j, s)
    type(characteristic_matrix), intent(in) :: matrix
    integer, intent(in) :: j
    real(wp), intent(in) :: s
    real(wp) :: values(merge(matrix%n_dof(), 1, matrix%is_symmetric), 1)
    call evaluate(matrix, [s], values)
    value_at = values(j, 1)
  end function value_at

  !> Add the root between two points with different signs: secants that keep the bracket (the
  !! Illinois rule), and bisection where they are slow.
  subroutine add_between(matrix, j, ends, at_ends, roots)
    type(characteristic_matrix), intent(in) :: matrix
    integer, intent(in) :: j
    real(wp), intent(in) :: ends(2), at_ends(2)
    real(wp), allocatable, intent(inout) :: roots(:)
    real(wp) :: a, b, f, g, h, middle, width
    integer :: k

    a = ends(1)
    b = ends(2)
    f = at_ends(1)
    g = at_ends(2)
    width = abs(b - a)
    do k = 1, most_steps
      if (abs(b - a) <= close_enough*max(abs(a), abs(b))) exit
      if (max(abs(a), abs(b)) <= at_zero*matrix%cut) exit
      middle = b - g*(b - a)/(g - f)
      ! Every third step is a bisection unless the interval has become much shorter.
      if (mod(k, 3) == 0) then
        if (abs(b - a) > 0.125_wp*width) middle = 0.5_wp*(a + b)
        width = abs(b - a)
      end if
      if (.not. (middle > min(a, b) .and. middle < max(a, b))) middle = 0.5_wp*(a + b)
      h = value_at(matrix, j, middle)
      if (differ(h, g)) then
        a = b
        f = g
      else
        f = 0.5_wp*f
      end if
      b = middle
      g = h
      if (.not. abs(g) > 0.0_wp) exit
    end do
    if (abs(b) <= at_zero*matrix%cut) b = 0.0_wp
    roots = [roots, b]
  end subroutine add_between

  !> Add two roots near a smallest value, if its sign differs: by golden section search.
  subroutine add_pair(matrix, j, points, at_points, roots)
    type(characteristic_matrix), intent(in) :: matrix
    integer, intent(in) :: j
    real(wp), intent(in) :: points(3), at_points(3)
    real(wp), allocatable, intent(inout) :: roots(:)
    real(wp), parameter :: golden = 0.38196601125010515_wp
    real(wp) :: a, b, c, d, f, g, side
    integer :: k

    side = sign(1.0_wp, at_points(2))
    a = points(1)
    b = points(3)
    c = a + golden*(b - a)
    d = b - golden*(b - a)
    f = side*value_at(matrix, j, c)
    g = side*value_at(matrix, j, d)
    do k = 1, most_sections
      if (min(f, g) < 0.0_wp) exit
      if (b - a <= 1.0e-12_wp*abs(points(2))) return
      if (f < g) then
        b = d
        d = c
        g = f
        c = a + golden*(b - a)
        f = side*value_at(matrix, j, c)
      else
        a = c
        c = d
        f = g
        d = b - golden*(b - a)
        g = side*value_at(matrix, j, d)
      end if
    end do
    if (.not. min(f, g) < 0.0_wp) return
    if (g < f) then
      c = d
      f = g
    end if
    call add_between(matrix, j, [points(1), c], [at_points(1), side*f], roots)
    call add_between(matrix, j, [c, points(3)], [side*f, at_points(3)], roots)
  end subroutine add_pair

end module viscovib_real_roots
