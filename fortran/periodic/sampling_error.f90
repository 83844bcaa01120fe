!> What the samples of a period leave of error in a harmonic balance.
!!
!! Harmonics of a force come from samples at which orders above N/2 alias onto those kept, or from
!! integrals between places where it switches, which samples find. With four times the samples the
!! same orders have a residual R(x) at a solution x, which by the derivatives J of the equations
!! solved moves it by -J^-1 R(x). Polynomial forces have samples enough, and no such error.
module viscovib_sampling_error
  use viscovib_dense, only: factorize, solve
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set, samples_of_laws
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: weighted_norm
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: sampling_judge

  !> Samples of the finer balance for each of the other.
  integer, parameter :: finer = 4
  !> What samples that are four times as many lack themselves, and how uncertain J is.
  real(wp), parameter :: safety = 2.0_wp

  !> Balances of some orders, which are kept for the next motion.
  type :: sampling_judge
    private
    integer :: highest = 0, n_samples = 0
    logical :: half_wave = .false.
    type(balance_type) :: own, fine
  contains
    procedure :: error_of
    procedure :: forget
  end type sampling_judge

contains

  !> The next motion is one of another system.
  subroutine forget(self)
    class(sampling_judge), intent(inout) :: self
    self%highest = 0
  end subroutine forget

  !> The relative error of a motion in the norm of `weighted_norm`; negative if it is not known.
  subroutine error_of(self, system, load, nu, factor, half_wave, x, error)
    class(sampling_judge), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency (rad/s), and factor of the load.
    real(wp), intent(in) :: nu, factor
    !> Whether odd orders alone are kept.
    logical, intent(in) :: half_wave
    !> Harmonics relative to the base, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    real(wp), intent(out) :: error
    real(wp), dimension(size(x, 1), size(x, 2)) :: r, s
    real(wp) :: jacobian(size(x), size(x)), norm
    type(harmonic_set_type) :: set
    integer :: pivots(size(x)), highest
    logical :: singular

    error = 0.0_wp
    if (system%degree > 0) return
    norm = weighted_norm(system, x)
    if (.not. norm > 0.0_wp) return
    highest = merge(size(x, 1) - 1, size(x, 1)/2 - 1, half_wave)
    if (highest /= self%highest .or. (half_wave .neqv. self%half_wave)) then
      call new_harmonic_set(set, highest, half_wave, system%degree)
      call new_balance(self%own, system, set)
      self%highest = highest
      self%half_wave = half_wave
      self%n_samples = 0
    end if
    call see(self%own, r)
    call self%own%derivatives(system, jacobian)
    call factorize(size(x), jacobian, pivots, singular)
    error = -1.0_wp
    if (singular) return
    if (self%own%samples_taken() /= self%n_samples) then
      self%n_samples = self%own%samples_taken()
      call new_harmonic_set(set, highest, half_wave, &
                            finer*max(samples_of_laws, &
                                      nint(real(self%n_samples, wp)/max(highest, 1))) - 1)
      call new_balance(self%fine, system, set)
    end if
    call see(self%fine, s)
    ! What the samples differ by; or, where the motion was found with more of them, what it lacks.
    r = s - r
    call solve(size(x), jacobian, pivots, r)
    call solve(size(x), jacobian, pivots, s)
    error = min(1.0_wp, safety*min(weighted_norm(system, r), weighted_norm(system, s))/norm)

  contains

    !> The residual by a balance.
    subroutine see(balance, residual)
      type(balance_type), intent(inout) :: balance
      real(wp), intent(out) :: residual(:, :)
      call balance%set_frequency(system, load, nu)
      balance%load_factor = factor
      call balance%residual(system, x, residual)
    end subroutine see

  end subroutine error_of

end module viscovib_sampling_error
