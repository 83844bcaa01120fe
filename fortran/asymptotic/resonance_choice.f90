!> What counts as resonant, by what a term does.
!!
!! A product M of generators whose frequency is near that of mode j adds c M to the change of Y_j,
!! c = l_j R_M/(l_j L[s_M, s_j] r_j), or, left out there, the wave c M/(s_M - s_j) to Y_j. That is
!! a small change of variables as long as its slope by each amplitude is small,
!!
!!   influence = max_f |c| |dM/dY_f|/|s_M - s_j|,
!!
!! f over the modes among the factors. With one that is at rest, and waves of loads, this is what
!! parametric excitation does to it, which grows from rest once |c dM/dY_f| > |s_M - s_j|/2, at an
!! influence of 1/2. Products of loads alone are compared with the motion.
module viscovib_resonance_choice
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: candidate_type, influence

  !> From here on a term is resonant; below, what its wave leaves over goes with the square.
  real(wp), parameter, public :: least_influence = 0.05_wp
  !> Terms farther from a mode than this part of its frequency are no part of the modulation
  !! equations, but may make modes at rest grow: looked at from half of where that begins.
  real(wp), parameter, public :: far = 0.5_wp, least_of_far = 0.25_wp
  !> Where no amplitudes are known: this part of the highest frequency.
  real(wp), parameter, public :: default_band = 0.05_wp

  type :: candidate_type
    !> Number of factors, place of the product, mode; factors as generators, 0: none.
    integer :: order = 0, at = 0, mode = 0, factors(3) = 0
    real(wp) :: coupling = 0.0_wp, divisor = 0.0_wp
    !> Farther than `far`.
    logical :: is_far = .false.
    !> In the modulation equations; wanted there, but with no place in their frame.
    logical :: taken = .false., turned_away = .false.
    !> Without a place in the frame though loads and the mode alone may sustain a motion by it.
    logical :: lost = .false.
  end type candidate_type

contains

  !> As above for generators of these sizes, the first n_modes of each half modes.
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
