!> Errors of periodic motions as solutions of their equations: the remaining correction, and
!! rounding errors.
!!
!! The residual R(x) of a motion x with given orders displaces it by -J^-1 R(x) with the derivatives
!! J. The error of R itself is the unit roundoff times its largest term; J^-1 times that is the
!! smallest possible error (Higham, Accuracy and Stability of Numerical Algorithms (2002) ch. 7).
!! Inertia and stiffness, which cancel in resonance, are separate terms. Coordinates that are not
!! excited are omitted.
module viscovib_rounding_error
  use viscovib_dense, only: factorize, solve
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: weighted_norm
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  implicit none
  private

  public :: rounding_checker

  !> Rounding error of an equation relative to its largest term, and number of sign patterns.
  real(wp), parameter :: usual = 2.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3

  !> The balance of a set of orders.
  type :: kept_balance
    integer :: highest = -1
    logical :: half_wave = .false.
    type(balance_type) :: balance
  end type kept_balance

  !> Data kept for the next motion of the same system: its balance, and the system without the
  !! coordinates that are not excited, if there are any.
  type :: rounding_checker
    private
    type(kept_balance) :: kept
    logical, allocatable :: moved(:)
    type(polynomial_type) :: reduced
    type(load_type) :: part
  contains
    procedure :: error_of
  end type rounding_checker

contains

  !> The relative error of a motion in the norm of `weighted_norm`; negative if unknown.
  subroutine error_of(self, system, load, nu, half_wave, linear, x, error)
    class(rounding_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency (rad/s).
    real(wp), intent(in) :: nu
    !> True for odd orders only, and true for forces linearized at zero.
    logical, intent(in) :: half_wave, linear
    !> Harmonics relative to the base, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    real(wp), intent(out) :: error
    logical :: moved(size(x, 2))
    integer :: d

    moved = moved_coordinates(system, load%drives(system) .or. any(abs(x) > 0.0_wp, 1))
    if (.not. allocated(self%moved)) self%moved = .not. moved
    if (any(moved .neqv. self%moved)) then
      self%moved = moved
      self%kept%highest = -1
      if (.not. all(moved)) then
        call reduce(system, moved, self%reduced)
        call load%take_part(moved, self%part)
      end if
    end if
    if (all(moved)) then
      call whole_error(self%kept, system, load, nu, half_wave, linear, x, error)
    else
      call whole_error(self%kept, self%reduced, self%part, nu, half_wave, linear, &
                       x(:, pack([(d, d=1, size(moved))], moved)), error)
    end if
  end subroutine error_of

  !> The same for all coordinates.
  subroutine whole_error(self, system, load, nu, half_wave, linear, x, error)
    type(kept_balance), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    logical, intent(in) :: half_wave, linear
    real(wp), intent(in) :: x(:, :)
    real(wp), intent(out) :: error
    real(wp), dimension(size(x, 1), size(x, 2)) :: left, terms, pushed
    real(wp) :: jacobian(size(x), size(x)), norm
    type(harmonic_set_type) :: set
    integer :: pivots(size(x)), highest, i, d, k
    logical :: singular

    error = 0.0_wp
    norm = weighted_norm(system, x)
    if (.not. norm > 0.0_wp) return
    if (.not. half_wave) then
      ! A mean requires the integral of every kernel.
      if (system%kernel_without_integral() /= 0) error = -1.0_wp
      if (error < 0.0_wp) return
    end if
    highest = merge(size(x, 1) - 1, size(x, 1)/2 - 1, half_wave)
    if (highest /= self%highest .or. (half_wave .neqv. self%half_wave)) then
      call new_harmonic_set(set, highest, half_wave, system%degree)
      call new_balance(self%balance, system, set)
      self%highest = highest
      self%half_wave = half_wave
    end if
    call self%balance%set_frequency(system, load, nu)
    call self%balance%residual(system, merge(0.0_wp, 1.0_wp, linear)*x, left)
    call self%balance%derivatives(system, jacobian)
    if (linear) left = left + reshape(matmul(jacobian, reshape(x, [size(x)])), shape(x))
    call find_terms(self%balance, system, x, jacobian, terms)
    call factorize(size(x), jacobian, pivots, singular)
    error = -1.0_wp
    if (singular) return
    call solve(size(x), jacobian, pivots, left)
    error = weighted_norm(system, left)
    do i = 1, all_signs
      do d = 1, size(x, 2)
        do k = 1, size(x, 1)
          pushed(k, d) = sign(usual*terms(k, d), cos(real(i*(k + size(x, 1)*d + i)**2, wp)))
        end do
      end do
      call solve(size(x), jacobian, pivots, pushed)
      error = max(error, weighted_norm(system, pushed))
    end do
    error = min(1.0_wp, error/norm)
  end subroutine whole_error

  !> The largest terms of the equations of each coordinate: all orders share the rounding errors of
  !! samples.
  subroutine find_terms(balance, system, x, jacobian, terms)
    type(balance_type), intent(in) :: balance
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :), jacobian(:, :)
    real(wp), intent(out) :: terms(:, :)
    real(wp) :: inertia(size(x, 1), size(x, 2))
    integer :: d, e, k

    do k = 1, size(x, 1)
      inertia(k, :) = (balance%set%orders((k + 1)/2)*balance%nu)**2*abs(x(k, :))
    end do
    terms = reshape(maxval(abs(jacobian)*spread(reshape(abs(x), [size(x)]), 1, size(x)), 2), &
                    shape(x))
    do d = 1, size(x, 2)
      do e = 1, size(x, 2)
        terms(:, d) = max(maxval(terms(:, d)), abs(system%mass(d, e))*maxval(inertia(:, e)))
      end do
    end do
    terms(:balance%set%held(), :) = 0.0_wp
  end subroutine find_terms

end module viscovib_rounding_error
