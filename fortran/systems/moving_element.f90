!> Elements of a motion in time that know what was: hysteresis, and stops with restitution.
!!
!! Hysteresis (viscovib_hysteresis): between two turns of its deflection d the states depend on the
!! change of d since the last one alone, so that the force is a smooth function of d there; surfaces
!! are d' = 0 and the places at which a state has a kink.
!!
!! A stop with restitution e: at d = gap the velocity along its normal n, n . v < 0, becomes
!! -e n . v by an impulse M^(-1) n (Newton's law of impact). Where the flight that would follow
!! rises less than rounding of the place, all the impacts that were to come, their times a
!! geometric series, are taken as one: the motion rests against the stop from its sum on, until
!! the stop would have to pull.
module viscovib_moving_element
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  implicit none
  private

  public :: fastest_settling, moving_element, new_moving_element

  !> What `state` of a law that is a stop with restitution is; its numbers are gap, restitution, and
  !! 1 if it stands on both sides.
  integer, parameter, public :: state_stop = 100
  !> Kinks nearer than this part of a deflection are where the state is already.
  real(wp), parameter :: nearest = 1.0e-13_wp

  type :: moving_element
    !> Whether it is a stop; d = e . u; M^(-1) times the direction in which its force acts.
    logical :: is_stop = .false.
    real(wp), allocatable :: e(:), weights(:)
    !> Of a stop: gap, restitution, on both sides, and since when it rests on each.
    real(wp) :: gap = 0.0_wp, restitution = 0.0_wp
    logical :: both = .false.
    real(wp) :: since(2) = -1.0_wp
    !> Of hysteresis: stiffness that is linear at rest, deflection and states at the last turn or
    !! kink, the way since then, how far the next kink is, and whether it is set.
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

  !> The force without its linear part at rest.
  pure real(wp) function force(self, d)
    class(moving_element), intent(in) :: self
    real(wp), intent(in) :: d
    real(wp) :: z(size(self%z)), by_z(size(self%z)), by_d(size(self%z)), work
    z = self%z
    call self%memory%advance(d - self%from, z, by_z, by_d, work)
    force = self%memory%force(d, z) - self%stiffness*d
  end function force

  !> Of hysteresis: how fast its states settle where the deflection moves on so (1/s). A disturbance
  !! of z' = g(z) d' changes as (dg/dz) d' times itself.
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

  !> The largest of some elements at states, shape (n, n_dof).
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

  !> The power with which the force begins at a surface, where it is not smooth on its sides (0: it
  !! is).
  pure real(wp) function roughness(self, which)
    class(moving_element), intent(in) :: self
    integer, intent(in) :: which
    roughness = 0.0_wp
    if (which == 2 .and. .not. self%is_stop) roughness = self%memory%rough
  end function roughness

  !> What is watched of its surfaces, at a deflection and its rate: of hysteresis the rate, and how
  !! far the next kink is; of a stop how far it is.
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

  !> Hysteresis at a turn (1) or a kink (2).
  subroutine turn(self, which, d)
    class(moving_element), intent(inout) :: self
    integer, intent(in) :: which
    real(wp), intent(in) :: d
    real(wp) :: by_z(size(self%z)), by_d(size(self%z)), work, change

    change = d - self%from
    ! A little beyond, lest rounding leaves it before its kink.
    if (which == 2) change = self%way*self%ahead*(1.0_wp + 8.0_wp*epsilon(1.0_wp))
    call self%memory%advance(change, self%z, by_z, by_d, work)
    self%from = self%from + change
    if (which == 1) self%way = -self%way
    call self%look_ahead()
  end subroutine turn

  !> At the start of a motion: from a state of rest straight to the deflection.
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

  !> How many numbers it must know to go on.
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
