! Optimize: -O3 -fstack-arrays
!> Elements with internal state in time integration: hysteresis, and stops with restitution.
!!
!! Hysteresis (viscovib_hysteresis): between two reversals of its deflection d the states depend
!! only on the change of d since the last reversal, so the force is a smooth function of d. The
!! switching surfaces are d' = 0 and the deflections at which a state has a kink.
!!
!! A stop with restitution e: at d = gap the velocity along its normal n, n . v < 0, becomes -e n .
!! v by an impulse M^(-1) n (Newton's law of impact). When the next flight would rise less than the
!! rounding error of the coordinate, all remaining impacts (their times form a geometric series) are
!! replaced by one. The stop then stays closed until it would have to pull.
module viscovib_moving_element
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  implicit none
  private

  public :: fastest_settling, moving_element, new_moving_element

  !> Value of `state` of a law that is a stop with restitution. Its parameters are the gap, the
  !! restitution, and 1 for a stop on both sides.
  integer, parameter, public :: state_stop = 100
  !> Kinks closer than this fraction of a deflection count as reached.
  real(wp), parameter :: nearest = 1.0e-13_wp

  type :: moving_element
    !> True for a stop; d = e . u; M^(-1) times the direction of its force.
    logical :: is_stop = .false.
    real(wp), allocatable :: e(:), weights(:)
    !> Stop: gap, restitution, both sides, and time since which each side is closed (-1: open).
    real(wp) :: gap = 0.0_wp, restitution = 0.0_wp
    logical :: both = .false.
    real(wp) :: since(2) = -1.0_wp
    !> Hysteresis: linear stiffness at zero states, deflection and states at the last reversal or
    !! kink, direction since then, distance to the next kink, and whether it is initialized.
    class(hysteresis_type), allocatable :: memory
    real(wp) :: stiffness = 0.0_wp, from = 0.0_wp, ahead = 0.0_wp
    real(wp), allocatable :: z(:)
    integer :: way = 1
    logical :: is_set = .false.
  contains
    procedure :: n_surfaces
    procedure :: force
    procedure :: settling
    procedure :: roughness
    procedure :: surface
    procedure :: turn
    procedure :: set
    procedure :: n_kept
    procedure :: keep
    procedure :: recall
    procedure, private :: look_ahead
  end type moving_element

contains

  subroutine new_moving_element(self, law, inverse)
    type(moving_element), intent(out) :: self
    type(law_term), intent(in) :: law
    !> M^(-1).
    real(wp), intent(in) :: inverse(:, :)

    self%e = law%arguments(1, :)
    self%weights = matmul(inverse(:, law%equations), law%weights)
    associate (numbers => law%program%number(2:))
      if (law%state == state_stop) then
        self%is_stop = .true.
        self%gap = numbers(1)
        self%restitution = numbers(2)
        self%both = numbers(3) > 0.0_wp
        return
      end if
      call new_hysteresis(self%memory, law%state, numbers)
    end associate
    self%stiffness = self%memory%stiffness_at_rest()
    allocate (self%z(self%memory%n_states()), source=0.0_wp)
    self%ahead = huge(1.0_wp)
  end subroutine new_moving_element

  pure integer function n_surfaces(self)
    class(moving_element), intent(in) :: self
    n_surfaces = 2
    if (self%is_stop .and. .not. self%both) n_surfaces = 1
  end function n_surfaces

  !> The force without its linear part at zero states.
  pure real(wp) function force(self, d)
    class(moving_element), intent(in) :: self
    real(wp), intent(in) :: d
    real(wp) :: z(size(self%z)), by_z(size(self%z)), by_d(size(self%z)), work
    z = self%z
    call self%memory%advance(d - self%from, z, by_z, by_d, work)
    force = self%memory%force(d, z) - self%stiffness*d
  end function force

  !> Relaxation rate of hysteresis states at a deflection rate (1/s). A perturbation of z' = g(z) d'
  !! changes at the rate (dg/dz) d'.
  pure real(wp) function settling(self, d, rate)
    class(moving_element), intent(in) :: self
    real(wp), intent(in) :: d, rate
    real(wp), dimension(size(self%z)) :: z, slopes, by_z, by_d
    real(wp) :: work
    z = self%z
    call self%memory%advance(d - self%from, z, by_z, by_d, work)
    call self%memory%slope(z, self%way, slopes, by_z)
    settling = maxval(abs(by_z))*abs(rate)
  end function settling

  !> Largest relaxation rate of all elements over all states, shape (n, n_dof).
  pure real(wp) function fastest_settling(elements, q, v) result(fastest)
    type(moving_element), intent(in) :: elements(:)
    real(wp), intent(in) :: q(:, :), v(:, :)
    integer :: i, k
    fastest = 0.0_wp
    do i = 1, size(elements)
      if (elements(i)%is_stop) cycle
      associate (e => elements(i)%e)
        do k = 1, size(q, 1)
          fastest = max(fastest, elements(i)%settling(dot_product(e, q(k, :size(e))), &
                                                      dot_product(e, v(k, :size(e)))))
        end do
      end associate
    end do
  end function fastest_settling

  !> Exponent of the force at a surface that is not smooth on its sides (0: the force is smooth
  !! there).
  pure real(wp) function roughness(self, which)
    class(moving_element), intent(in) :: self
    integer, intent(in) :: which
    roughness = 0.0_wp
    if (which == 2 .and. .not. self%is_stop) roughness = self%memory%rough
  end function roughness

  !> Event function of a surface: for hysteresis the deflection rate (1) or the distance to the next
  !! kink (2); for a stop the remaining gap.
  pure real(wp) function surface(self, which, d, rate)
    class(moving_element), intent(in) :: self
    integer, intent(in) :: which
    real(wp), intent(in) :: d, rate
    if (self%is_stop) then
      surface = self%gap + merge(-d, d, which == 1)
    else if (which == 1) then
      surface = rate
    else
      surface = 1.0_wp
      if (self%ahead < huge(1.0_wp)) surface = self%ahead - self%way*(d - self%from)
    end if
  end function surface

  !> Update hysteresis at a reversal (1) or a kink (2).
  subroutine turn(self, which, d)
    class(moving_element), intent(inout) :: self
    integer, intent(in) :: which
    real(wp), intent(in) :: d
    real(wp) :: by_z(size(self%z)), by_d(size(self%z)), work, change

    change = d - self%from
    ! Step slightly beyond the kink, so that rounding errors do not leave the state before it.
    if (which == 2) change = self%way*self%ahead*(1.0_wp + 8.0_wp*epsilon(1.0_wp))
    call self%memory%advance(change, self%z, by_z, by_d, work)
    self%from = self%from + change
    if (which == 1) self%way = -self%way
    call self%look_ahead()
  end subroutine turn

  !> Initialize the element by a monotonic path from zero states to the deflection d.
  subroutine set(self, d, rate)
    class(moving_element), intent(inout) :: self
    real(wp), intent(in) :: d, rate
    real(wp), allocatable :: by_z(:), by_d(:)
    real(wp) :: work
    if (self%is_stop .or. self%is_set) return
    self%is_set = .true.
    allocate (by_z(size(self%z)), by_d(size(self%z)))
    call self%memory%advance(d, self%z, by_z, by_d, work)
    self%from = d
    self%way = merge(1, -1, rate >= 0.0_wp)
    call self%look_ahead()
  end subroutine set

  subroutine look_ahead(self)
    class(moving_element), intent(inout) :: self
    real(wp) :: distances(size(self%z)), small
    call self%memory%kinks(self%z, self%way, distances)
    small = nearest*max(abs(self%from), tiny(1.0_wp))
    self%ahead = huge(1.0_wp)
    if (any(distances > small)) self%ahead = minval(distances, distances > small)
  end subroutine look_ahead

  !> Number of values that `keep` saves for a continuation.
  pure integer function n_kept(self)
    class(moving_element), intent(in) :: self
    n_kept = 2
    if (.not. self%is_stop) n_kept = 4 + size(self%z)
  end function n_kept

  pure function keep(self) result(kept)
    class(moving_element), intent(in) :: self
    real(wp) :: kept(self%n_kept())
    if (self%is_stop) then
      kept = self%since
    else
      kept = [merge(1.0_wp, 0.0_wp, self%is_set), self%from, self%ahead, real(self%way, wp), self%z]
    end if
  end function keep

  subroutine recall(self, kept)
    class(moving_element), intent(inout) :: self
    real(wp), intent(in) :: kept(:)
    if (self%is_stop) then
      self%since = kept(:2)
      return
    end if
    self%is_set = kept(1) > 0.0_wp
    self%from = kept(2)
    self%ahead = kept(3)
    self%way = nint(kept(4))
    self%z = kept(5:4 + size(self%z))
  end subroutine recall

end module viscovib_moving_element
