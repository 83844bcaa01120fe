!> A system by the method of multiple scales: its normal form and modulation equations,
!! and what follows from them without solving anything.
module viscovib_multiple_scales
  use viscovib_kinds, only: wp
  use viscovib_normal_form, only: new_normal_form, normal_form_type
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_slow_flow, only: new_slow_flow, slow_flow_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: multiple_scales_type, new_multiple_scales

  type :: multiple_scales_type
    type(normal_form_type) :: normal
    type(slow_flow_type) :: flow
  contains
    procedure :: interaction
  end type multiple_scales_type

contains

  subroutine new_multiple_scales(scales, form, tolerance, steady, status)
    type(multiple_scales_type), intent(out) :: scales
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    !> As in `new_normal_form`.
    logical, intent(in) :: steady
    type(status_type), intent(out) :: status
    call new_normal_form(scales%normal, form, tolerance, steady, status)
    if (.not. status%failed()) call new_slow_flow(scales%flow, scales%normal, form)
  end subroutine new_multiple_scales

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
          gamma(t%row, k) = gamma(t%row, k) + 0.25_wp*t%coefficient
        end do
      end associate
    end do
  end function interaction

end module viscovib_multiple_scales
