!> A periodic motion where none is found from zero: solved under strong damping, which is then
!! removed gradually.
!!
!! The term (1 - s) sigma i k nu M X_k is added to the equations of harmonic balance, for the mean
!! (1 - s) sigma^2 M X_0. The curve over s is followed from 0 to 1, through folds if necessary.
!! Under strong damping there is one motion and no resonance on the way.
module viscovib_damped_start
  use viscovib_curve, only: curve_type
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_curve_newton, only: solve_on_curve
  use viscovib_equation_terms, only: raise_by_inertia
  use viscovib_harmonic_balance, only: balance_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: point_from_damping

  !> Number of damping rates tried, in units of the frequency, and largest number of points.
  integer, parameter :: n_rates = 8, max_points = 800
  real(wp), parameter :: first_rate = 2.0_wp, ratio = 4.0_wp, max_step = 0.3_wp, &
                         loose = 1.0e-8_wp

  type, extends(curve_type) :: damped_curve_type
    type(balance_type), pointer :: balance => null()
    class(oscillator_type), pointer :: system => null()
    !> The frequency (rad/s), and the rate of the added damping (1/s).
    real(wp) :: nu = 0.0_wp, rate = 0.0_wp
  contains
    procedure :: equations
    procedure :: raise_terms
  end type damped_curve_type

contains

  !> Solve at the present frequency and load of `balance`.
  subroutine point_from_damping(balance, system, nu, tolerance, x, made, cancel)
    type(balance_type), intent(inout), target :: balance
    class(oscillator_type), intent(in), target :: system
    !> Frequency of the load (rad/s).
    real(wp), intent(in) :: nu, tolerance
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(out) :: x(:, :)
    logical, intent(out) :: made
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(damped_curve_type) :: curve
    type(curve_branch_type) :: branch
    real(wp) :: start(size(x))
    integer :: d, k, outcome, iterations

    curve%n = size(x)
    curve%balance => balance
    curve%system => system
    curve%nu = nu
    curve%largest = system%largest_amplitude()
    curve%weights = [(spread(system%mass(d, d), 1, size(x, 1)), d=1, size(x, 2))]
    made = .false.
    x = 0.0_wp
    do k = 1, n_rates
      if (is_set(cancel)) return
      curve%rate = first_rate*ratio**(k - 1)*nu
      start = 0.0_wp
      iterations = 0
      call solve_on_curve(curve, 0.0_wp, sqrt(tolerance), start, outcome, iterations, cancel)
      if (outcome /= outcome_converged) cycle
      call follow_curve(curve, curve_options(0.0_wp, 1.0_wp, max(tolerance, loose), max_points, &
                                             max_step), start, branch, cancel=cancel)
      made = branch%outcome == curve_completed .and. branch%n_points > 0
      if (made) exit
    end do
    if (made) x = reshape(branch%x(:, branch%n_points), shape(x))
  end subroutine point_from_damping

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(damped_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    real(wp) :: factor
    integer :: a, b, k, m, row, column

    inside = .true.
    call self%balance%residual(self%system, x, r)
    call self%balance%derivatives(self%system, jacobian)
    slope = 0.0_wp
    m = size(self%balance%set%orders)
    do b = 1, self%system%n_dof()
      do a = 1, self%system%n_dof()
        if (.not. abs(self%system%mass(a, b)) > 0.0_wp) cycle
        do k = 1, m
          row = 2*(k + m*(a - 1))
          column = 2*(k + m*(b - 1))
          if (self%balance%set%orders(k) == 0) then
            factor = self%rate**2*self%system%mass(a, b)
            call put(row, column, factor)
            cycle
          end if
          factor = self%rate*self%balance%set%orders(k)*self%nu*self%system%mass(a, b)
          call put(row - 1, column, -factor)
          call put(row, column - 1, factor)
        end do
      end do
    end do

  contains

    subroutine put(row, column, factor)
      integer, intent(in) :: row, column
      real(wp), intent(in) :: factor
      r(row) = r(row) + (1.0_wp - p)*factor*x(column)
      slope(row) = slope(row) - factor*x(column)
      jacobian(row, column) = jacobian(row, column) + (1.0_wp - p)*factor
    end subroutine put

  end subroutine equations

  !> Include the terms of inertia and of the added damping.
  subroutine raise_terms(self, x, p, terms)
    class(damped_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    integer :: k
    associate (orders => self%balance%set%orders)
      call raise_by_inertia(self%system%mass, [(rate(orders((k + 1)/2)*self%nu), &
                                                k=1, 2*size(orders))], x, terms)
    end associate

  contains

    pure real(wp) function rate(w)
      real(wp), intent(in) :: w
      rate = sqrt(w*(w + (1.0_wp - p)*self%rate))
    end function rate

  end subroutine raise_terms

end module viscovib_damped_start
