!> Error of the motion of a structure due to rounding of its frequencies and poles.
!!
!! A frequency omega has the error eps omega. After a time t its mode has the phase error
!! eps omega t, for any step size, so that no comparison of runs shows it:
!!
!!   |dq| = eps t |q'|,    |dq'| = eps t omega |q'|,    |dz| = eps t |pole z|,                   (1)
!!
!! where t is at most the decay time of the mode, since earlier motion has decayed. For an
!! oscillating mode the phase of its samples is unknown, so that the largest values of (1) are
!! used; those of different modes are independent of each other.
module viscovib_structure_phases
  use viscovib_kinds, only: wp
  use viscovib_modal_maps, only: sections_type
  use viscovib_structure_state, only: state_type
  implicit none
  private

  public :: new_phases, phases_type

  !> Relative error of a frequency: at most half of the rounding of its square, and as much from the
  !! steps.
  real(wp), parameter :: known_to = 2.0_wp*epsilon(1.0_wp)
  !> Bound of motions; larger ones diverge.
  real(wp), parameter :: largest = sqrt(huge(1.0_wp))

  type :: phases_type
    !> Decay times of modes and of the part without real modes; largest t |q'| and t |z| so far.
    real(wp), allocatable, private :: fading(:), fading_others(:), swept(:), swept_others(:)
  contains
    procedure :: follow
    procedure :: errors
  end type phases_type

contains

  subroutine new_phases(phases, sections)
    type(phases_type), intent(out) :: phases
    type(sections_type), intent(in) :: sections

    associate (squares => sections%squares, rates => sections%rates, poles => sections%others%poles)
      allocate (phases%fading(size(squares)), phases%fading_others(size(poles)), source=largest)
      ! exp(-rate t/2), and exp(-square t/rate) for overdamped modes.
      where (rates > 1.0_wp/largest .and. squares > rates/largest)
        phases%fading = max(2.0_wp/rates, rates/squares)
      end where
      where (-real(poles) > 1.0_wp/largest) phases%fading_others = -1.0_wp/real(poles)
      allocate (phases%swept(size(squares)), phases%swept_others(size(poles)), source=0.0_wp)
    end associate
  end subroutine new_phases

  !> Process a step that ends at time t.
  pure subroutine follow(self, state, t)
    class(phases_type), intent(inout) :: self
    type(state_type), intent(in) :: state
    real(wp), intent(in) :: t
    self%swept = max(self%swept, min(t, self%fading)*min(abs(state%v), largest))
    self%swept_others = max(self%swept_others, min(t, self%fading_others) &
                            *min(abs(state%z), largest))
  end subroutine follow

  !> Errors of the observed values, (u_1, u'_1, ...).
  pure function errors(self, sections, shown, shown_left)
    class(phases_type), intent(in) :: self
    type(sections_type), intent(in) :: sections
    !> By modes, shapes (n, n_shown) and (n_poles, n_shown).
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    real(wp) :: errors(2*size(shown, 2))
    integer :: d

    associate (squares => abs(sections%squares), sizes => abs(sections%others%poles))
      do d = 1, size(shown, 2)
        errors(2*d - 1) = norm2([norm2(shown(:, d)*self%swept), &
                                 norm2(abs(shown_left(:, d))*sizes*self%swept_others)])
        errors(2*d) = norm2([norm2(shown(:, d)*sqrt(squares)*self%swept), &
                             norm2(abs(shown_left(:, d))*sizes**2*self%swept_others)])
      end do
    end associate
    errors = known_to*errors
  end function errors

end module viscovib_structure_phases
