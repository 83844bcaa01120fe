!> Elements with memory of where they turned: what every one of them can do.
!!
!! The force is f = elastic d + sum_j weight_j z_j of a deflection d and states z that follow it
!! whatever its speed (rate-independent hysteresis), each by itself:
!!
!!   dz_j/dd = g_j(z_j, way),   way = sign(d').
!!
!! As long as d does not turn back z thus depends on the change of d alone, and a whole step is
!! exact however long it is. An element of a user is one file that extends this type, named by the
!! option `elements` of the build; one of the library is a case of `viscovib_hysteresis_catalogue`.
module viscovib_hysteresis
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: hysteresis_type

  type, abstract :: hysteresis_type
    !> Stiffness in parallel with the states (N/m), and their weights, shape (n_states).
    real(wp) :: elastic = 0.0_wp
    real(wp), allocatable :: weight(:)
    !> The power with which the force begins at a kink, where it is not smooth on its sides (0: it
    !! is).
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

    !> Move the states along while the deflection changes without turning back.
    pure subroutine advance_interface(self, change, z, by_z, by_d, work)
      import :: hysteresis_type, wp
      class(hysteresis_type), intent(in) :: self
      !> Of the deflection, of either sign (m).
      real(wp), intent(in) :: change
      !> States before, and after, shape (n_states); 0 at rest.
      real(wp), intent(inout) :: z(:)
      !> Derivatives of the states after, by those before and by the deflection after (that by the
      !! deflection before is its negative), shape (n_states).
      real(wp), intent(out) :: by_z(:), by_d(:)
      !> Integral of sum_j weight_j z_j over d (J): over a cycle that repeats it is lost.
      real(wp), intent(out) :: work
    end subroutine advance_interface

    !> dz/dd at states, and its derivative by them, shape (n_states).
    pure subroutine slope_interface(self, z, way, slopes, by_z)
      import :: hysteresis_type, wp
      class(hysteresis_type), intent(in) :: self
      real(wp), intent(in) :: z(:)
      !> 1 where d grows, -1 where it falls.
      integer, intent(in) :: way
      real(wp), intent(out) :: slopes(:), by_z(:)
    end subroutine slope_interface

    !> How far d has yet to go, > 0, until a state has a kink over d (`huge` if it has none), shape
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

  !> df/dd where nothing has moved yet.
  pure real(wp) function stiffness_at_rest(self)
    class(hysteresis_type), intent(in) :: self
    real(wp), dimension(size(self%weight)) :: rest, slopes, by_z
    rest = 0.0_wp
    call self%slope(rest, 1, slopes, by_z)
    stiffness_at_rest = self%elastic + sum(self%weight*slopes)
  end function stiffness_at_rest

end module viscovib_hysteresis
