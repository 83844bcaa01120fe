!> Sampling error of a harmonic balance.
!!
!! Harmonics of a force are computed from samples, at which orders above N/2 alias, or from
!! integrals between switching phases, which are found from samples. With four times the samples,
!! the same orders have a residual R(x) at a solution x, which displaces it by -J^-1 R(x) with the
!! derivatives J. A solution that was found with that many samples shows no residual; so the number
!! is multiplied by four until the estimate changes little. Polynomial forces have enough samples
!! and no such error.
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

  public :: sampling_checker

  !> Factor of the number of samples between finer balances, and number of these; largest number of
  !! samples after the second one.
  integer, parameter :: finer = 4, n_finer = 4, most_samples = 32768
  !> Factor for the error of the finer samples, and for the error of J.
  real(wp), parameter :: safety = 2.0_wp
  !> Largest relative change of the estimate between two sample numbers; and its rounding error.
  real(wp), parameter :: settled = 0.25_wp, rounding = 1.0e-13_wp

  !> Balances of a set of orders, kept for the next motion.
  type :: sampling_checker
    private
    integer :: highest = 0, n_samples = 0, n_made = 0
    logical :: half_wave = .false.
    type(balance_type) :: own, fine(n_finer)
  contains
    procedure :: error_of
    procedure :: forget
  end type sampling_checker

contains

  !> Reset before a motion of another system.
  subroutine forget(self)
    class(sampling_checker), intent(inout) :: self
    self%highest = 0
  end subroutine forget

  !> The relative error of a motion in the norm of `weighted_norm`; negative if unknown.
  subroutine error_of(self, system, load, nu, factor, half_wave, x, error)
    class(sampling_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency (rad/s), and load factor.
    real(wp), intent(in) :: nu, factor
    !> True for odd orders only.
    logical, intent(in) :: half_wave
    !> Harmonics relative to the base, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    real(wp), intent(out) :: error
    real(wp), dimension(size(x, 1), size(x, 2)) :: moved, before
    real(wp) :: jacobian(size(x), size(x)), norm, change
    type(harmonic_set_type) :: set
    integer :: pivots(size(x)), highest, i
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
    call set_up(self%own, system, load, nu, factor)
    call self%own%residual(system, x, before)
    call self%own%derivatives(system, jacobian)
    call factorize(size(x), jacobian, pivots, singular)
    error = -1.0_wp
    if (singular) return
    call solve(size(x), jacobian, pivots, before)
    if (self%own%samples_taken() /= self%n_samples) then
      self%n_samples = self%own%samples_taken()
      self%n_made = 0
    end if
    do i = 1, n_finer
      if (i > 2 .and. self%n_samples*finer**i > most_samples) exit
      if (i > self%n_made) call make_finer(self, system, i)
      call set_up(self%fine(i), system, load, nu, factor)
      call self%fine(i)%residual(system, x, moved)
      call solve(size(x), jacobian, pivots, moved)
      error = weighted_norm(system, moved)/norm
      change = weighted_norm(system, moved - before)/norm
      ! An error may be small by chance: two successive estimates must agree.
      if (change <= max(merge(settled*error, 0.0_wp, i > 1), rounding)) exit
      error = max(error, change)
      before = moved
    end do
    error = min(1.0_wp, safety*error)
  end subroutine error_of

  !> Create the finer balance i.
  subroutine make_finer(self, system, i)
    type(sampling_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: i
    type(harmonic_set_type) :: set
    integer :: own

    own = max(samples_of_laws, nint(real(self%n_samples, wp)/max(self%highest, 1)))
    call new_harmonic_set(set, self%highest, self%half_wave, finer**i*own - 1)
    call new_balance(self%fine(i), system, set)
    self%n_made = i
  end subroutine make_finer

  !> Set the frequency and the load factor of a balance.
  subroutine set_up(balance, system, load, nu, factor)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, factor
    call balance%set_frequency(system, load, nu)
    balance%load_factor = factor
  end subroutine set_up

end module viscovib_sampling_error
