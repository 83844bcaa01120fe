!> A system by the method of multiple scales: its normal form and modulation equations,
!! and what follows from them without solving anything.
!!
!! Everything inside is in natural units (`viscovib_natural_units`): amplitudes a_j multiply
!! shapes whose largest entry is 1 there. Callers' amplitudes multiply shapes whose largest
!! coordinate is 1 in their own units: a_j times `amplitude_units`.
module viscovib_multiple_scales
  use viscovib_kinds, only: wp
  use viscovib_natural_units, only: to_natural_units
  use viscovib_normal_form, only: new_normal_form, normal_form_type
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_slow_flow, only: new_slow_flow, slow_flow_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: multiple_scales_type, new_multiple_scales

  type :: multiple_scales_type
    !> The system, in natural units.
    type(polynomial_form_type) :: form
    type(normal_form_type) :: normal
    type(slow_flow_type) :: flow
    !> Factors of the equations and units of the unknowns, shape (n); of amplitudes,
    !! shape (n_modes).
    real(wp), allocatable :: rows(:), columns(:)
    complex(wp), allocatable :: amplitude_units(:)
    !> What motions of unlike unknowns are compared in, shape (n): a length, an angle, ...
    real(wp), allocatable :: units(:)
  contains
    procedure :: interaction
    procedure :: shapes
    procedure :: coefficient
  end type multiple_scales_type

contains

  subroutine new_multiple_scales(scales, form, tolerance, steady, status)
    type(multiple_scales_type), intent(out) :: scales
    !> In the caller's units.
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    !> As in `new_normal_form`.
    logical, intent(in) :: steady
    type(status_type), intent(out) :: status
    complex(wp) :: r(form%n_dof)
    integer :: j

    call form%copy_to(scales%form)
    call to_natural_units(scales%form, scales%rows, scales%columns, scales%units)
    call new_normal_form(scales%normal, scales%form, tolerance, steady, status)
    if (status%failed()) return
    call new_slow_flow(scales%flow, scales%normal, scales%form)
    allocate (scales%amplitude_units(form%n_modes()))
    do j = 1, form%n_modes()
      r = scales%columns(:form%n_dof)*scales%normal%right(:form%n_dof, j)
      scales%amplitude_units(j) = r(maxloc(abs(r), 1))
    end do
  end subroutine new_multiple_scales

  !> Shapes of the modes in the caller's units, columns, the largest coordinate 1.
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

end module viscovib_multiple_scales
