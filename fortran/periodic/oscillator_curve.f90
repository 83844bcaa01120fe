!> Periodic motions of an oscillator as a curve: the harmonics over the frequency or
!! the factor of the load.
module viscovib_oscillator_curve
  use viscovib_curve, only: curve_type
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: oscillator_curve_type, new_oscillator_curve

  !> What the parameter is.
  integer, parameter, public :: vary_frequency = 1, vary_load = 2

  type, extends(curve_type) :: oscillator_curve_type
    type(balance_type) :: balance
    class(oscillator_type), pointer :: system => null()
    type(load_type), pointer :: load => null()
    integer :: vary = vary_frequency
    !> `set` makes another system.
    logical :: changes_system = .false.
  contains
    procedure :: equations
    procedure :: residual
    procedure :: set
  end type oscillator_curve_type

contains

  !> For a varying load the balance is to be set to its frequency.
  subroutine new_oscillator_curve(curve, system, load, set, vary)
    type(oscillator_curve_type), intent(out) :: curve
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(harmonic_set_type), intent(in) :: set
    integer, intent(in) :: vary
    integer :: d, rows

    call new_balance(curve%balance, system, set)
    curve%system => system
    curve%load => load
    curve%vary = vary
    curve%n = curve%balance%n
    curve%largest = system%largest_amplitude()
    if (vary == vary_frequency) curve%lowest = 0.0_wp
    rows = 2*size(set%orders)
    allocate (curve%weights(curve%n))
    do d = 1, system%n_dof()
      curve%weights((d - 1)*rows + 1:d*rows) = system%mass(d, d)
    end do
  end subroutine new_oscillator_curve

  !> Set the balance to a value of the parameter, unless that is out of range.
  subroutine set(self, p, inside)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: p
    logical, intent(out) :: inside
    inside = p > self%lowest
    if (.not. inside) return
    if (self%vary == vary_frequency) then
      call self%balance%set_frequency(self%system, self%load, p)
    else
      self%balance%load_factor = p
    end if
  end subroutine set

  subroutine residual(self, x, p, r, inside)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    call self%set(p, inside)
    if (inside) call self%balance%residual(self%system, x, r)
  end subroutine residual

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    call self%residual(x, p, r, inside)
    if (.not. inside) return
    if (self%vary == vary_frequency) then
      call self%balance%frequency_derivative(self%system, self%load, x, slope)
    else
      call self%balance%load_derivative(slope)
    end if
    call self%balance%derivatives(self%system, jacobian)
  end subroutine equations

end module viscovib_oscillator_curve
