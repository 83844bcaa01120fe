! Optimize: -O3
!> Abstract hysteresis element with rate-independent states.
!!
!! The force is f = elastic d + sum_j weight_j z_j of a deflection d and independent states z. The
!! states follow d at any speed (rate-independent hysteresis):
!!
!!   dz_j/dd = g_j(z_j, way),   way = sign(d').
!!
!! As long as d does not reverse, z depends on the change of d alone, so a step of any length is
!! exact. A user-defined element is one file that extends this type, named by the build option
!! `elements`. An element of the library is a case of `viscovib_hysteresis_catalogue`.
module viscovib_hysteresis
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: hysteresis_type

  type, abstract :: hysteresis_type
    !> Stiffness in parallel with the states (N/m), and their weights, shape (n_states).
    real(wp) :: elastic = 0.0_wp
    real(wp), allocatable :: weight(:)
    !> Exponent of the force at a kink that is not smooth on its sides (0: the force is smooth
    !! there).
    real(wp) :: rough = 0.0_wp
  contains
    procedure(advance_interface), deferred :: advance
    procedure(slope_interface), deferred :: slope
    procedure(kinks_interface), deferred :: kinks
    procedure :: n_states
    procedure :: force
    procedure :: stiffness_at_rest
  end type hysteresis_type

  abstract interface

    !> Advance the states for a change of the deflection without reversal.
    pure subroutine advance_interface(self, change, z, by_z, by_d, work)
      import :: hysteresis_type, wp
      class(hysteresis_type), intent(in) :: self
      !> Change of the deflection, of either sign (m).
      real(wp), intent(in) :: change
      !> States before and after the change, shape (n_states); 0 initially.
      real(wp), intent(inout) :: z(:)
      !> Derivatives of the final states by the initial states and by the final deflection, shape
      !! (n_states). The derivative by the initial deflection is the negative of `by_d`.
      real(wp), intent(out) :: by_z(:), by_d(:)
      !> Integral of sum_j weight_j z_j over d (J): the dissipated energy for a periodic cycle.
      real(wp), intent(out) :: work
    end subroutine advance_interface

    !> dz/dd at given states, and its derivative by the states, shape (n_states).
    pure subroutine slope_interface(self, z, way, slopes, by_z)
      import :: hysteresis_type, wp
      class(hysteresis_type), intent(in) :: self
      real(wp), intent(in) :: z(:)
      !> 1 where d grows, -1 where it falls.
      integer, intent(in) :: way
      real(wp), intent(out) :: slopes(:), by_z(:)
    end subroutine slope_interface

    !> Remaining change of d, > 0, until a state has a kink over d (`huge`: no kink), shape
    !! (n_states).
    pure subroutine kinks_interface(self, z, way, distances)
      import :: hysteresis_type, wp
      class(hysteresis_type), intent(in) :: self
      real(wp), intent(in) :: z(:)
      integer, intent(in) :: way
      real(wp), intent(out) :: distances(:)
    end subroutine kinks_interface

  end interface

contains

  pure integer function n_states(self)
    class(hysteresis_type), intent(in) :: self
    n_states = size(self%weight)
  end function n_states

  !> f (N).
  pure real(wp) function force(self, d, z)
    class(hysteresis_type), intent(in) :: self
    real(wp), intent(in) :: d, z(:)
    force = self%elastic*d + sum(self%weight*z)
  end function force

  !> df/dd at zero states.
  pure real(wp) function stiffness_at_rest(self)
    class(hysteresis_type), intent(in) :: self
    real(wp), dimension(size(self%weight)) :: rest, slopes, by_z
    rest = 0.0_wp
    call self%slope(rest, 1, slopes, by_z)
    stiffness_at_rest = self%elastic + sum(self%weight*slopes)
  end function stiffness_at_rest

end module viscovib_hysteresis
