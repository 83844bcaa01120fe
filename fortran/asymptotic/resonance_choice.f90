!> Selection of resonant terms by their effect.
!!
!! A product M of generators whose frequency is near that of mode j adds c M to the change of Y_j, c
!! = l_j R_M/(l_j L[s_M, s_j] r_j), or, if omitted there, c M/(s_M - s_j) to Y_j. This is a small
!! change of variables as long as its derivative by each amplitude is small,
!!
!!   influence = max_f |c| |dM/dY_f|/|s_M - s_j|,
!!
!! where f runs over the modes among the factors. For a mode at rest and oscillating loads this is
!! parametric excitation: the mode grows from rest if |c dM/dY_f| > |s_M - s_j|/2, that is, from an
!! influence of 1/2 on. Products of loads alone are compared with the motion.
module viscovib_resonance_choice
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: candidate_type, influence

  !> Influence from which a term is resonant; below it the error of its effect is of second order.
  real(wp), parameter, public :: least_influence = 0.05_wp
  !> Terms farther from a mode than this fraction of its frequency are not part of the modulation
  !! equations, but may make modes at rest grow: examined from half of this threshold on.
  real(wp), parameter, public :: far = 0.5_wp, least_of_far = 0.25_wp
  !> If no amplitudes are known: this fraction of the highest frequency.
  real(wp), parameter, public :: default_band = 0.05_wp

  type :: candidate_type
    !> Number of factors, index of the product, mode; factors as generators, 0: none.
    integer :: order = 0, at = 0, mode = 0, factors(3) = 0
    real(wp) :: coupling = 0.0_wp, divisor = 0.0_wp
    !> Farther than `far`.
    logical :: is_far = .false.
    !> Part of the modulation equations; resonant, but not compatible with their frame.
    logical :: taken = .false., turned_away = .false.
    !> Not compatible with the frame, although loads and this mode alone may sustain a motion.
    logical :: lost = .false.
  end type candidate_type

contains

  !> Influence for generators of these sizes; the first n_modes of each half are modes.
  pure real(wp) function influence(candidate, sizes, n_modes, reference)
    type(candidate_type), intent(in) :: candidate
    !> Shape (n_generators).
    real(wp), intent(in) :: sizes(:)
    integer, intent(in) :: n_modes
    !> Size of the motion of first order.
    real(wp), intent(in) :: reference
    real(wp) :: slope
    integer :: which(3), q, other

    which(:candidate%order) = modulo(candidate%factors(:candidate%order) - 1, size(sizes)) + 1
    influence = 0.0_wp
    do q = 1, candidate%order
      if (which(q) > n_modes) cycle
      slope = real(count(candidate%factors(:candidate%order) == candidate%factors(q)), wp)
      do other = 1, candidate%order
        if (other /= q) slope = slope*sizes(which(other))
      end do
      influence = max(influence, slope)
    end do
    if (all(which(:candidate%order) > n_modes)) then
      influence = product(sizes(which(:candidate%order)))
      if (reference > 0.0_wp) influence = influence/reference
    end if
    influence = influence*candidate%coupling
    ! Exact resonance without damping.
    if (influence > 0.0_wp) then
      if (candidate%divisor > influence*tiny(1.0_wp)) then
        influence = min(influence/candidate%divisor, huge(1.0_wp))
      else
        influence = huge(1.0_wp)
      end if
    end if
  end function influence

end module viscovib_resonance_choice
