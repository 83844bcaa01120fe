! Optimize: -O2 -fstack-arrays
!> A system by the method of multiple scales: its normal form and modulation equations,
!! and results that need no solution of equations.
!!
!! All components are in natural units (`to_natural_units`): amplitudes a_j multiply
!! shapes whose largest entry is 1 there. Callers' amplitudes multiply shapes whose largest
!! coordinate is 1 in their own units: a_j times `amplitude_units`. The expansion is about the
!! equilibrium under the constant loads.
module viscovib_multiple_scales
  use viscovib_kinds, only: wp
  use viscovib_normal_form, only: new_normal_form
  use viscovib_normal_products, only: default_band, normal_form_type, reach_type
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_rest_position, only: move_to_rest
  use viscovib_slow_flow, only: new_slow_flow, slow_flow_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: multiple_scales_type, new_multiple_scales, reach_of

  type :: multiple_scales_type
    !> The system, in natural units.
    type(polynomial_form_type) :: form
    type(normal_form_type) :: normal
    type(slow_flow_type) :: flow
    !> Factors of the equations and units of the unknowns, shape (n); of amplitudes,
    !! shape (n_modes).
    real(wp), allocatable :: rows(:), columns(:)
    complex(wp), allocatable :: amplitude_units(:)
    !> Scales for the comparison of different kinds of unknowns, shape (n): a length, an angle, ...
    real(wp), allocatable :: units(:)
    !> Equilibrium under constant loads, in the caller's units, shape (n).
    real(wp), allocatable :: rest(:)
    !> Amplitudes of the loads divided by those of the full system that the form approximates,
    !! shape (n_loads).
    real(wp), allocatable :: load_factor(:)
  contains
    procedure :: interaction
    procedure :: shapes
    procedure :: coefficient
  end type multiple_scales_type

contains

  subroutine new_multiple_scales(scales, form, tolerance, steady, status, reach, sizes, &
                                 with_far)
    !> Its arrays are kept if their shapes are the same.
    type(multiple_scales_type), intent(inout) :: scales
    !> In the caller's units.
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    !> As in `new_normal_form`.
    logical, intent(in) :: steady
    type(status_type), intent(out) :: status
    !> As in `new_normal_form`, for the same form except for oscillating loads.
    type(reach_type), intent(in), optional :: reach
    real(wp), intent(in), optional :: sizes(:)
    !> Include terms far from the modes.
    logical, intent(in), optional :: with_far
    integer :: j, k

    scales%load_factor = spread(1.0_wp, 1, size(form%drives))
    if (present(reach)) then
      call reach%form%copy_to(scales%form)
      scales%form%drives = form%drives
      do k = 1, size(form%drives)
        if (form%drives(k) > 0.0_wp) scales%form%load(:, k) = form%load(:, k)*reach%rows
      end do
      scales%rest = reach%rest
      scales%rows = reach%rows
      scales%columns = reach%columns
      scales%units = reach%units
    else
      call form%copy_to(scales%form)
      call move_to_rest(scales%form, scales%rest, status)
      if (status%failed()) return
      call to_natural_units(scales%form, scales%rows, scales%columns, scales%units)
    end if
    call new_normal_form(scales%normal, scales%form, tolerance, steady, status, reach, sizes, &
                         with_far)
    if (status%failed()) return
    call new_slow_flow(scales%flow, scales%normal, scales%form)
    associate (d => form%n_dof)
      scales%amplitude_units = [(largest(scales%columns(:d)*scales%normal%right(:d, j)), &
                                 j=1, form%n_modes())]
    end associate
  end subroutine new_multiple_scales

  !> The entry of the largest modulus.
  pure complex(wp) function largest(r)
    complex(wp), intent(in) :: r(:)
    largest = r(maxloc(abs(r), 1))
  end function largest

  !> Shifts of the modes by nonlinear terms, without oscillating loads; the modes; the form in
  !! natural units.
  subroutine reach_of(form, reach, status)
    !> In the caller's units.
    type(polynomial_form_type), intent(in) :: form
    type(reach_type), intent(out) :: reach
    type(status_type), intent(out) :: status
    type(polynomial_form_type) :: free
    type(multiple_scales_type) :: scales
    integer :: i, k

    call form%copy_to(free)
    do k = 1, size(free%drives)
      if (free%drives(k) > 0.0_wp) free%load(:, k) = 0.0_wp
    end do
    call new_multiple_scales(scales, free, default_band, .true., status)
    allocate (reach%cubic(form%n_modes()), reach%quadratic(form%n_modes()), source=0.0_wp)
    if (status%failed()) return
    associate (normal => scales%normal, n => form%n_modes())
      reach%s = normal%exponents(:n)
      reach%right = normal%right(:, :n)
      reach%left = normal%left(:, :n)
    end associate
    call scales%form%copy_to(reach%form)
    reach%rows = scales%rows
    reach%columns = scales%columns
    reach%units = scales%units
    reach%rest = scales%rest
    do i = 1, size(scales%flow%terms)
      associate (t => scales%flow%terms(i), c => abs(scales%flow%terms(i)%coefficient))
        if (count(t%at == t%row) == 2 .and. any(t%at == -t%row)) then
          reach%cubic(t%row) = reach%cubic(t%row) + c
        else if (count(t%at /= 0) == 2) then
          reach%quadratic(t%row) = max(reach%quadratic(t%row), c)
        end if
      end associate
    end do
  end subroutine reach_of

  !> Shapes of the modes in the caller's units, one per column; the largest coordinate is 1.
  pure function shapes(self)
    class(multiple_scales_type), intent(in) :: self
    complex(wp) :: shapes(self%form%n, self%flow%n_modes)
    integer :: j
    do j = 1, self%flow%n_modes
      shapes(:, j) = self%columns*self%normal%right(:, j)/self%amplitude_units(j)
    end do
  end function shapes

  !> The coefficient of term i of the modulation equations in the caller's units.
  pure complex(wp) function coefficient(self, i)
    class(multiple_scales_type), intent(in) :: self
    integer, intent(in) :: i
    integer :: q, k
    associate (t => self%flow%terms(i), unit => self%amplitude_units)
      coefficient = t%coefficient*unit(t%row)
      do q = 1, 3
        k = t%at(q)
        if (k > 0) coefficient = coefficient/unit(k)
        if (k < 0) coefficient = coefficient/conjg(unit(-k))
      end do
    end associate
  end function coefficient

  !> gamma_jk: with real amplitudes b_k = 2 |a_k|, the exponent of mode j is
  !! s_j + sum_k gamma_jk b_k^2; the imaginary part is the change of the frequency.
  pure function interaction(self) result(gamma)
    class(multiple_scales_type), intent(in) :: self
    complex(wp) :: gamma(self%flow%n_modes, self%flow%n_modes)
    integer :: i, k

    gamma = (0.0_wp, 0.0_wp)
    do i = 1, size(self%flow%terms)
      associate (t => self%flow%terms(i))
        do k = 1, self%flow%n_modes
          if (count(t%at == -k) /= 1 .or. any(t%loads /= 0)) cycle
          if (count(t%at == t%row) /= merge(2, 1, k == t%row)) cycle
          if (k /= t%row .and. count(t%at == k) /= 1) cycle
          gamma(t%row, k) = gamma(t%row, k) + 0.25_wp*self%coefficient(i)
        end do
      end associate
    end do
  end function interaction

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

end module viscovib_multiple_scales
