!> A polynomial form in units of its own modes, so that thresholds, pivots and norms compare
!! quantities of the same kind and do not depend on the caller's units.
!!
!! Unknown d is measured in C_d = sqrt(sum_j |r_dj|^2/|l_j A_2 r_j|), r_j and l_j the vectors of
!! the modes without damping and memory: for mass-normalised shapes of coordinates this is
!! sqrt((M^-1)_dd), a length for a length, an angle for an angle and, of hereditary variables,
!! a force for a force. They scale with the caller's units, so that comparisons do not depend on
!! these. With powers of two, the ratio of two amplitudes would depend on the units, and so would
!! the choice of resonant terms. C is rounded to few digits: similar coordinates get equal units.
!! Equations are divided by their largest linear term at the highest natural frequency, by powers
!! of two, since no comparison is made between equations.
module viscovib_natural_units
  use viscovib_kinds, only: wp
  use viscovib_polynomial_form, only: polynomial_form_type
  implicit none
  private

  public :: to_natural_units

contains

  subroutine to_natural_units(form, rows, columns, units)
    type(polynomial_form_type), intent(inout) :: form
    !> Factors of equations and units of unknowns, shape (n).
    real(wp), allocatable, intent(out) :: rows(:), columns(:)
    !> The units of unknowns before they are rounded, shape (n).
    real(wp), allocatable, intent(out) :: units(:)
    integer :: i, j, k

    units = units_of_unknowns(form)
    columns = few_digits(units)
    rows = factors_of_equations(form, columns)
    do k = 0, 2
      form%linear(:, :, k) = in_units(form%linear(:, :, k))
    end do
    form%hereditary = in_units(form%hereditary)
    do i = 1, size(form%quadratic)
      associate (t => form%quadratic(i))
        t%coefficient = t%coefficient*rows(t%row)*product(columns(form%source(t%at(:2))))
      end associate
    end do
    do i = 1, size(form%cubic)
      associate (t => form%cubic(i))
        t%coefficient = t%coefficient*rows(t%row)*product(columns(form%source(t%at)))
      end associate
    end do
    do j = 1, size(form%drives)
      form%load(:, j) = form%load(:, j)*rows
    end do
    do j = 1, form%n_modes()
      form%right(:, j) = form%right(:, j)/columns
      form%right(:, j) = form%right(:, j)/power_of_two(maxval(abs(form%right(:, j))))
      form%left(:, j) = form%left(:, j)/rows
      form%left(:, j) = form%left(:, j)/power_of_two(maxval(abs(form%left(:, j))))
    end do

  contains

    pure function in_units(matrix) result(scaled)
      real(wp), intent(in) :: matrix(:, :)
      real(wp) :: scaled(size(matrix, 1), size(matrix, 2))
      integer :: column
      do column = 1, size(matrix, 2)
        scaled(:, column) = matrix(:, column)*rows*columns(column)
      end do
    end function in_units

  end subroutine to_natural_units

  pure function units_of_unknowns(form) result(units)
    type(polynomial_form_type), intent(in) :: form
    real(wp), allocatable :: units(:)
    real(wp) :: mass
    integer :: j

    allocate (units(form%n), source=0.0_wp)
    do j = 1, form%n_modes()
      mass = abs(sum(form%left(:, j)*matmul(form%linear(:, :, 2), form%right(:, j))))
      if (mass > 0.0_wp) units = hypot(units, form%right(:, j)/sqrt(mass))
    end do
    ! An unknown that no mode moves has no natural unit.
    where (.not. units > 0.0_wp) units = 1.0_wp
  end function units_of_unknowns

  pure function factors_of_equations(form, columns) result(rows)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: columns(:)
    real(wp), allocatable :: rows(:)
    real(wp) :: speed
    integer :: i

    speed = maxval(form%omega)
    allocate (rows(form%n))
    do i = 1, form%n
      rows(i) = maxval(columns*(abs(form%linear(i, :, 0)) + abs(form%hereditary(i, :)) &
                                + speed*(abs(form%linear(i, :, 1)) &
                                         + speed*abs(form%linear(i, :, 2)))))
    end do
    where (rows > 0.0_wp)
      rows = 1.0_wp/power_of_two(rows)
    else where
      rows = 1.0_wp
    end where
  end function factors_of_equations

  !> Round to 20 binary digits.
  elemental real(wp) function few_digits(x)
    real(wp), intent(in) :: x
    integer, parameter :: digits_kept = 20
    few_digits = scale(anint(scale(fraction(x), digits_kept)), exponent(x) - digits_kept)
  end function few_digits

  elemental real(wp) function power_of_two(x)
    real(wp), intent(in) :: x
    power_of_two = scale(1.0_wp, exponent(x) - 1)
  end function power_of_two

end module viscovib_natural_units
