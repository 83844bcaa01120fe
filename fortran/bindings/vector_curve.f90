!> Periodic motions as a curve over one of the numbers that make the system, at a
!! frequency and a load that stay: the system is built anew at each value.
module viscovib_vector_curve
  use viscovib_binding_tools, only: make_system
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_load
  use viscovib_status, only: status_type
  implicit none
  private

  public :: new_plain_curve, new_vector_curve

  !> Step of a central difference, as a part of the size of the parameter.
  real(wp), parameter :: part = 1.0e-6_wp

  type :: system_holder
    class(oscillator_type), allocatable :: system
  end type system_holder

  type, extends(oscillator_curve_type) :: vector_curve_type
    !> The system as in mount_binding, and which number of `flat` varies.
    real(wp), allocatable :: flat(:), data_x(:), data_phi(:)
    integer :: kind_x = 0, kind_phi = 0, entry = 0
    !> Frequency of the load (rad/s), and what counts as a small parameter.
    real(wp) :: nu = 0.0_wp, p_scale = 1.0_wp
    type(system_holder), pointer, private :: own => null()
  contains
    procedure :: equations
    procedure :: set
    procedure :: left_out
    final :: discard
  end type vector_curve_type

contains

  !> The curve over the frequency or the factor of the load.
  subroutine new_plain_curve(curve, system, load, set, vary, nu)
    class(oscillator_curve_type), allocatable, intent(out) :: curve
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(harmonic_set_type), intent(in) :: set
    integer, intent(in) :: vary
    real(wp), intent(in) :: nu
    allocate (curve)
    call new_oscillator_curve(curve, system, load, set, vary)
    call curve%balance%set_frequency(system, load, nu)
  end subroutine new_plain_curve

  !> The curve over number `entry` of `flat`, beginning at p.
  subroutine new_vector_curve(curve, flat, kind_x, data_x, kind_phi, data_phi, entry, p, p_scale, &
                              load, set, nu, status)
    class(oscillator_curve_type), allocatable, intent(out) :: curve
    real(wp), intent(in) :: flat(:), data_x(:), data_phi(:), p, p_scale, nu
    integer, intent(in) :: kind_x, kind_phi, entry
    type(load_type), intent(in), target :: load
    type(harmonic_set_type), intent(in) :: set
    type(status_type), intent(out) :: status
    type(vector_curve_type), allocatable :: family

    allocate (family)
    family%flat = flat
    family%data_x = data_x
    family%data_phi = data_phi
    family%kind_x = kind_x
    family%kind_phi = kind_phi
    family%entry = entry
    family%nu = nu
    family%p_scale = p_scale
    family%flat(entry) = p
    allocate (family%own)
    call make_system(family%own%system, family%flat, kind_x, data_x, kind_phi, data_phi, status)
    if (.not. status%failed()) then
      call new_oscillator_curve(family%oscillator_curve_type, family%own%system, load, set, &
                                vary_load)
      call family%balance%set_frequency(family%system, load, nu)
    end if
    call move_alloc(family, curve)
  end subroutine new_vector_curve

  !> Values that make no system lie outside the curve.
  subroutine set(self, p, inside)
    class(vector_curve_type), intent(inout) :: self
    real(wp), intent(in) :: p
    logical, intent(out) :: inside
    type(status_type) :: status

    self%flat(self%entry) = p
    call make_system(self%own%system, self%flat, self%kind_x, self%data_x, self%kind_phi, &
                     self%data_phi, status)
    inside = .not. status%failed()
    if (.not. inside) return
    self%system => self%own%system
    call self%balance%set_frequency(self%system, self%load, self%nu)
    if (self%adaptive) call self%ladder%forget()
  end subroutine set

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(vector_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    real(wp) :: below(size(r)), h
    logical :: beside

    h = part*max(abs(p), self%p_scale)
    call self%residual(x, p + h, slope, beside)
    inside = beside
    call self%residual(x, p - h, below, beside)
    inside = inside .and. beside
    slope = (slope - below)/(2.0_wp*h)
    call self%residual(x, p, r, beside)
    inside = inside .and. beside
    if (inside) call self%balance%derivatives(self%system, jacobian)
  end subroutine equations

  subroutine left_out(self, x, p, pushed, own)
    class(vector_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: pushed(:), own
    logical :: inside
    call self%set(p, inside)
    call self%oscillator_curve_type%left_out(x, 1.0_wp, pushed, own)
  end subroutine left_out

  subroutine discard(self)
    type(vector_curve_type), intent(inout) :: self
    if (associated(self%own)) deallocate (self%own)
  end subroutine discard

end module viscovib_vector_curve
