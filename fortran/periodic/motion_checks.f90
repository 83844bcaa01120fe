!> Columns of periodic motions in tables in addition to harmonics: errors of the solution and of its
!! sampling, and energy lost in a period.
!!
!! The residual R(x) of a motion x with given orders displaces it by -J^-1 R(x) with the derivatives
!! J. The error of R itself is the unit roundoff times its largest term; J^-1 times that is the
!! smallest possible error (Higham, Accuracy and Stability of Numerical Algorithms (2002) ch. 7).
!! Inertia and stiffness, which cancel in resonance, are separate terms. Coordinates that are not
!! excited are omitted.
!!
!! Harmonics of a force are computed from samples, at which orders above N/2 alias, or from
!! integrals between switching phases, which are found from samples. With four times the samples,
!! the same orders have another residual. A solution that was found with that many samples shows no
!! residual; so the number is multiplied by four until the estimate changes little. Polynomial
!! forces have enough samples and no such error.
!!
!! With the harmonics F_k of all forces and X_k of the motion relative to the base, the energy is E
!! = pi sum_k k Im(F_k conj(X_k)). It is lost in dampers, rate laws, sliders and memory; springs and
!! masses return the energy that they store. For a structure, with its condensed coordinates, it is
!! the energy supplied by the loads: the formula with their harmonics P_k in place of F_k.
module viscovib_motion_checks
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_dense, only: factorize, solve
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set, samples_of_laws
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: weighted_norm
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: errors_of, sampling_of, losses_of, work_of, relative_motions

  !> Rounding error of an equation relative to its largest term, and number of sign patterns.
  real(wp), parameter :: usual = 2.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3
  !> Factor of the number of samples between finer balances, and number of these; largest number of
  !! samples after the second one.
  integer, parameter :: finer = 4, n_finer = 4, most_samples = 32768
  !> Factor for the error of the finer samples, and for the error of J.
  real(wp), parameter :: safety = 2.0_wp
  !> Largest relative change of the estimate between two sample numbers; and its rounding error.
  real(wp), parameter :: settled = 0.25_wp, rounding = 1.0e-13_wp

  !> The balance of a set of orders, kept for the next motion.
  type :: kept_balance
    integer :: highest = -1
    logical :: half_wave = .false.
    type(balance_type) :: balance
  contains
    procedure :: set_up
  end type kept_balance

  !> Data kept for the next motion of the same system: its balance, and the system without the
  !! coordinates that are not excited, if there are any.
  type :: rounding_checker
    type(kept_balance) :: kept
    logical, allocatable :: moved(:)
    type(polynomial_type) :: reduced
    type(load_type) :: part
  contains
    procedure :: rounding_error
  end type rounding_checker

  !> Balances kept for the next motion: with the samples of the motion, and with more.
  type :: sampling_checker
    type(kept_balance) :: own
    integer :: n_samples = 0, n_made = 0
    type(balance_type) :: fine(n_finer)
  contains
    procedure :: sampling_error
  end type sampling_checker

contains

  !> The balance of a motion with that many rows of harmonics, at a frequency (rad/s).
  subroutine set_up(self, system, load, nu, factor, half_wave, n_rows, renewed)
    class(kept_balance), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    !> Load factor.
    real(wp), intent(in) :: factor
    !> True for odd orders only.
    logical, intent(in) :: half_wave
    integer, intent(in) :: n_rows
    !> True if the orders are not those of the last motion.
    logical, intent(out), optional :: renewed
    type(harmonic_set_type) :: set
    integer :: highest
    logical :: new

    highest = merge(n_rows - 1, n_rows/2 - 1, half_wave)
    new = highest /= self%highest .or. (half_wave .neqv. self%half_wave)
    if (new) then
      call new_harmonic_set(set, highest, half_wave, system%degree)
      call new_balance(self%balance, system, set)
      self%highest = highest
      self%half_wave = half_wave
    end if
    if (present(renewed)) renewed = new
    call self%balance%set_frequency(system, load, nu)
    self%balance%load_factor = factor
  end subroutine set_up

  !> Subtract the motion of the base.
  subroutine relative_motions(system, load, orders, factor, motions)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    !> Load factor of each motion.
    real(wp), intent(in) :: factor(:)
    !> Shape (n_orders, n_dof, n).
    complex(wp), intent(inout) :: motions(:, :, :)
    complex(wp) :: y(size(motions, 2))
    integer :: d, j, k

    if (.not. load%moves_base()) return
    do j = 1, size(load%orders)
      k = findloc(orders, load%orders(j), 1)
      if (k == 0) cycle
      y = load%shift(system, j)
      do d = 1, size(y)
        motions(k, d, :) = motions(k, d, :) - factor*y(d)
      end do
    end do
  end subroutine relative_motions

  !> Relative errors of motions as solutions of their equations; NaN if unknown.
  subroutine errors_of(system, load, orders, nu, highest, linear, motions, errors, cancel)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    !> Frequency (rad/s) and highest order of each motion.
    real(wp), intent(in) :: nu(:)
    integer, intent(in) :: highest(:)
    !> True if the motions are those of the forces linearized at zero.
    logical, intent(in) :: linear
    !> Relative to the base, NaN if not found, shape (n_orders, n_dof, n).
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: errors(:)
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(rounding_checker) :: checker
    complex(wp), allocatable :: whole(:, :)
    integer, allocatable :: kept(:)
    integer :: i, k

    errors = ieee_value(errors, ieee_quiet_nan)
    ! Linear motions contain the load's orders only.
    if (linear .and. size(orders) > 0 .and. all(mod(orders, 2) == 1)) then
      allocate (kept, source=[(k, k=1, maxval(orders), 2)])
    else if (linear) then
      allocate (kept, source=[(k, k=0, max(0, maxval(orders)))])
    else
      allocate (kept, source=orders)
    end if
    do i = 1, size(nu)
      if (is_set(cancel)) return
      if (.not. is_finite(motions(:, :, i))) cycle
      allocate (whole(count(kept <= highest(i)), size(motions, 2)), source=(0.0_wp, 0.0_wp))
      do k = 1, count(orders <= highest(i))
        whole(findloc(kept, orders(k), 1), :) = motions(k, :, i)
      end do
      call checker%rounding_error(system, load, nu(i), kept(1) > 0, linear, unknowns(whole), &
                                  errors(i))
      if (errors(i) < 0.0_wp) errors(i) = ieee_value(errors(i), ieee_quiet_nan)
      deallocate (whole)
    end do
  end subroutine errors_of

  !> Relative errors by the sampling of forces; NaN if unknown.
  subroutine sampling_of(system, load, orders, nu, factor, highest, motions, errors, cancel)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    !> Frequency (rad/s), load factor, and highest order, of each motion.
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: highest(:)
    !> Relative to the base, shape (n_orders, n_dof, n).
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: errors(:)
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(sampling_checker) :: checker
    real(wp), allocatable :: x(:, :)
    integer :: i

    errors = ieee_value(errors, ieee_quiet_nan)
    do i = 1, size(nu)
      if (is_set(cancel)) return
      if (.not. is_known(motions(:, :, i), highest(i))) cycle
      x = unknowns(motions(:count(orders <= highest(i)), :, i))
      call checker%sampling_error(system, load, nu(i), factor(i), orders(1) > 0, x, errors(i))
      if (errors(i) < 0.0_wp) errors(i) = ieee_value(errors(i), ieee_quiet_nan)
    end do
  end subroutine sampling_of

  !> Energy that all forces of a system absorb in a period (J); NaN if no motion was found.
  subroutine losses_of(system, load, orders, nu, factor, highest, linear, motions, lost)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: highest(:)
    !> True if the motions are those of the forces linearized at zero.
    logical, intent(in) :: linear
    complex(wp), intent(in) :: motions(:, :, :)
    real(wp), intent(out) :: lost(:)
    type(kept_balance) :: kept
    integer :: i, m

    lost = ieee_value(lost, ieee_quiet_nan)
    do i = 1, size(nu)
      m = count(orders <= highest(i))
      if (linear) m = size(orders)
      if (.not. is_known(motions(:, :, i), m)) cycle
      if (linear) then
        lost(i) = of_linear(system, orders, nu(i), motions(:, :, i))
        cycle
      end if
      ! Forces only; not for `moving` systems, whose forces depend on the load.
      call kept%set_up(system, load, nu(i), 0.0_wp*factor(i), orders(1) > 0, 2*m)
      lost(i) = of_forces(kept%balance, system, orders(:m), motions(:m, :, i))
    end do
  end subroutine losses_of

  !> Work of forces in a period, pi sum_k k Im(P_k conj(X_k)).
  pure real(wp) function work_of(orders, force, x) result(work)
    integer, intent(in) :: orders(:)
    !> Shape (n_orders, n).
    complex(wp), intent(in) :: force(:, :), x(:, :)
    integer :: d

    work = 0.0_wp
    do d = 1, size(x, 2)
      work = work + pi*sum(orders*aimag(force(:, d)*conjg(x(:, d))))
    end do
  end function work_of

  real(wp) function of_forces(balance, system, orders, x) result(lost)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: orders(:)
    complex(wp), intent(in) :: x(:, :)
    real(wp) :: r(2*size(x, 1), size(x, 2))

    call balance%residual(system, unknowns(x), r)
    lost = work_of(orders, cmplx(r(1::2, :), r(2::2, :), wp), x)
  end function of_forces

  real(wp) function of_linear(system, orders, nu, x) result(lost)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu
    complex(wp), intent(in) :: x(:, :)
    complex(wp) :: fraction(size(orders), system%n_memory()), force(size(x, 1), size(x, 2))
    complex(wp) :: stiffness(size(x, 2), size(x, 2), size(orders))
    integer :: k

    call system%retained(orders*nu, fraction)
    call system%dynamic_stiffness(orders*nu, spread(nu, 1, size(orders)), fraction, stiffness)
    do k = 1, size(orders)
      force(k, :) = matmul(stiffness(:, :, k), x(k, :))
    end do
    lost = work_of(orders, force, x)
  end function of_linear

  !> Alternating real and imaginary parts.
  pure function unknowns(motion) result(x)
    complex(wp), intent(in) :: motion(:, :)
    real(wp) :: x(2*size(motion, 1), size(motion, 2))
    x(1::2, :) = real(motion)
    x(2::2, :) = aimag(motion)
  end function unknowns

  pure logical function is_known(motion, highest)
    complex(wp), intent(in) :: motion(:, :)
    integer, intent(in) :: highest
    is_known = highest > 0 .and. is_finite(motion)
  end function is_known

  pure logical function is_finite(motion)
    complex(wp), intent(in) :: motion(:, :)
    is_finite = all(ieee_is_finite(real(motion))) .and. all(ieee_is_finite(aimag(motion)))
  end function is_finite

  !> The relative error of a motion in the norm of `weighted_norm`; negative if unknown.
  subroutine rounding_error(self, system, load, nu, half_wave, linear, x, error)
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
  end subroutine rounding_error

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
    integer :: pivots(size(x)), i, d, k
    logical :: singular

    error = 0.0_wp
    norm = weighted_norm(system, x)
    if (.not. norm > 0.0_wp) return
    if (.not. half_wave) then
      ! A mean requires the integral of every kernel.
      if (system%kernel_without_integral() /= 0) error = -1.0_wp
      if (error < 0.0_wp) return
    end if
    call self%set_up(system, load, nu, 1.0_wp, half_wave, size(x, 1))
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

  !> The relative error of a motion in the norm of `weighted_norm`; negative if unknown.
  subroutine sampling_error(self, system, load, nu, factor, half_wave, x, error)
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
    integer :: pivots(size(x)), i
    logical :: singular, renewed

    error = 0.0_wp
    if (system%degree > 0) return
    norm = weighted_norm(system, x)
    if (.not. norm > 0.0_wp) return
    call self%own%set_up(system, load, nu, factor, half_wave, size(x, 1), renewed)
    call self%own%balance%residual(system, x, before)
    call self%own%balance%derivatives(system, jacobian)
    call factorize(size(x), jacobian, pivots, singular)
    error = -1.0_wp
    if (singular) return
    call solve(size(x), jacobian, pivots, before)
    if (renewed .or. self%own%balance%samples_taken() /= self%n_samples) then
      self%n_samples = self%own%balance%samples_taken()
      self%n_made = 0
    end if
    do i = 1, n_finer
      if (i > 2 .and. self%n_samples*finer**i > most_samples) exit
      if (i > self%n_made) call make_finer(self, system, i)
      call self%fine(i)%set_frequency(system, load, nu)
      self%fine(i)%load_factor = factor
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
  end subroutine sampling_error

  !> Create the finer balance i.
  subroutine make_finer(self, system, i)
    type(sampling_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: i
    type(harmonic_set_type) :: set
    integer :: own

    own = max(samples_of_laws, nint(real(self%n_samples, wp)/max(self%own%highest, 1)))
    call new_harmonic_set(set, self%own%highest, self%own%half_wave, finer**i*own - 1)
    call new_balance(self%fine(i), system, set)
    self%n_made = i
  end subroutine make_finer

end module viscovib_motion_checks
