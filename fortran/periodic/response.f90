! Optimize: -O3
!> The result of a forced response, and its options.
module viscovib_response
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_counters, only: count_up, counted_base, counting
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: stability_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged, outcome_overflow
  implicit none
  private

  public :: response_options, response_type

  type :: response_options
    !> Highest harmonic of a nonlinear response; or as many as the tolerance requires.
    integer :: harmonics = 9
    logical :: choose_harmonics = .false.
    !> Relative tolerance of the iteration, in the norm of `successive`.
    real(wp) :: tolerance = 1.0e-10_wp
    !> Additional absolute tolerance of each coordinate, in its unit; and its value in the norm.
    real(wp) :: absolute = 0.0_wp, least = 0.0_wp
    integer :: max_iterations = 200
    !> Fraction of each correction that is applied, in (0, 1]; 0: start with 1 and halve, up to four
    !! times, if the iteration does not converge.
    real(wp) :: relaxation = 1.0_wp
    !> Use the symmetry about half a period that forces and load may have.
    logical :: symmetric = .true.
    !> Keep the corrections of every iteration.
    logical :: keep_history = .false.
    !> Also keep all iterates.
    logical :: keep_iterates = .false.
    !> Determine the stability of each motion (Newton's method only).
    logical :: stability = .false.
    !> Solve a linear system by the nonlinear method, as on a branch.
    logical :: on_branch = .false.
    !> Include coordinates that are not excited, as needed for perturbations.
    logical :: keep_idle = .false.
  end type response_options

  type :: response_type
    !> Circular frequencies of the load (rad/s), shape (n).
    real(wp), allocatable :: nu(:)
    !> Included harmonics, and X_k in u = Im sum_k X_k exp(i k nu t), shape (size(orders), n_dof,
    !! n). NaN if no solution was found.
    integer, allocatable :: orders(:)
    complex(wp), allocatable :: coefficients(:, :, :)
    !> One of `viscovib_outcomes`, number of iterations, and the factor by which the last
    !! corrections shrank per iteration, shape (n).
    integer, allocatable :: outcome(:), iterations(:)
    !> Method that computed each motion, one of `method_names`, shape (n).
    integer, allocatable :: method(:)
    real(wp), allocatable :: rate(:)
    !> Highest order (0 if no solution was found; coefficients beyond it are 0), and the estimated
    !! relative truncation error, shape (n).
    integer, allocatable :: highest(:)
    real(wp), allocatable :: truncation(:)
    !> Allowed relative error: relative and absolute tolerance, shape (n).
    real(wp), allocatable :: allowed(:)
    !> Relative size of each correction, shape (0 or max_iterations, n); NaN after the last.
    real(wp), allocatable :: corrections(:, :)
    !> Iterates from the linear response on, shape (size(orders), n_dof, 1 + max_iterations, n); NaN
    !! after the last. Not allocated if not kept.
    complex(wp), allocatable :: iterates(:, :, :, :)
    !> Stability of each motion; arrays not allocated if not requested.
    type(stability_type) :: stability
  contains
    procedure :: allocate_for
    procedure :: allow
    procedure :: discard
    procedure :: renew
    procedure :: widen
    procedure :: replace
    procedure :: add_base_motion
    procedure :: keep_finite
    procedure :: spread_out
  end type response_type

contains

  !> Allocate for n frequencies, all zero and converged.
  subroutine allocate_for(self, nu, orders, n_dof, n_history)
    class(response_type), intent(out) :: self
    real(wp), intent(in) :: nu(:)
    integer, intent(in) :: orders(:), n_dof, n_history
    self%nu = nu
    self%orders = orders
    allocate (self%coefficients(size(orders), n_dof, size(nu)), source=(0.0_wp, 0.0_wp))
    allocate (self%outcome(size(nu)), source=outcome_converged)
    allocate (self%iterations(size(nu)), source=0)
    allocate (self%rate(size(nu)), source=0.0_wp)
    allocate (self%truncation(size(nu)), source=0.0_wp)
    allocate (self%allowed(size(nu)), source=0.0_wp)
    allocate (self%highest(size(nu)), source=max(0, maxval(orders)))
    allocate (self%corrections(n_history, size(nu)))
    self%corrections = ieee_value(0.0_wp, ieee_quiet_nan)
  end subroutine allocate_for

  !> Set the allowed error of a motion with a given norm (`weighted_norm`).
  pure subroutine allow(self, options, i, norm)
    class(response_type), intent(inout) :: self
    type(response_options), intent(in) :: options
    integer, intent(in) :: i
    real(wp), intent(in) :: norm
    self%allowed(i) = options%tolerance
    if (self%outcome(i) /= outcome_converged) return
    if (options%least > 0.0_wp) self%allowed(i) = options%tolerance &
                                                  + options%least/max(norm, tiny(norm)**0.5_wp)
  end subroutine allow

  !> Mark point i as without a solution: all values are NaN.
  subroutine discard(self, i, outcome)
    class(response_type), intent(inout) :: self
    integer, intent(in) :: i, outcome
    real(wp) :: nan
    nan = ieee_value(nan, ieee_quiet_nan)
    self%outcome(i) = outcome
    self%highest(i) = 0
    self%truncation(i) = nan
    self%coefficients(:, :, i) = cmplx(nan, nan, wp)
  end subroutine discard

  !> Reset point i to its state after `allocate_for`.
  subroutine renew(self, i)
    class(response_type), intent(inout) :: self
    integer, intent(in) :: i
    self%outcome(i) = outcome_converged
    self%coefficients(:, :, i) = (0.0_wp, 0.0_wp)
    self%iterations(i) = 0
    self%rate(i) = 0.0_wp
    self%corrections(:, i) = ieee_value(0.0_wp, ieee_quiet_nan)
  end subroutine renew

  !> Extend to more orders; the present ones must be the first of them.
  subroutine widen(self, orders)
    class(response_type), intent(inout) :: self
    integer, intent(in) :: orders(:)
    complex(wp), allocatable :: wider(:, :, :)
    integer :: i, m

    m = size(self%orders)
    allocate (wider(size(orders), size(self%coefficients, 2), size(self%nu)), &
              source=(0.0_wp, 0.0_wp))
    wider(:m, :, :) = self%coefficients
    do i = 1, size(self%nu)
      ! NaN where there is no solution.
      if (self%outcome(i) /= outcome_converged) wider(m + 1:, :, i) = self%coefficients(1, 1, i)
    end do
    call move_alloc(wider, self%coefficients)
    self%orders = orders
  end subroutine widen

  !> Replace some points by those of a response with more orders.
  subroutine replace(self, places, better)
    class(response_type), intent(inout) :: self
    integer, intent(in) :: places(:)
    type(response_type), intent(in) :: better

    call self%widen(better%orders)
    self%coefficients(:, :, places) = better%coefficients
    self%outcome(places) = better%outcome
    self%iterations(places) = better%iterations
    self%rate(places) = better%rate
    self%highest(places) = better%highest
    self%truncation(places) = better%truncation
    self%allowed(places) = better%allowed
    self%corrections(:, places) = better%corrections
  end subroutine replace

  !> Transform coordinates relative to the base to absolute ones.
  subroutine add_base_motion(self, system, load)
    class(response_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    complex(wp) :: y(system%n_dof())
    integer :: i, j, d

    if (.not. load%moves_base()) return
    do j = 1, size(load%orders)
      do i = 1, size(self%orders)
        if (self%orders(i) /= load%orders(j)) cycle
        if (counting) call count_up(counted_base, size(self%nu))
        y = load%shift(system, j)
        do d = 1, system%n_dof()
          self%coefficients(i, d, :) = self%coefficients(i, d, :) + y(d)
        end do
      end do
    end do
  end subroutine add_base_motion

  !> Discard converged motions that contain values that are not finite.
  subroutine keep_finite(self)
    class(response_type), intent(inout) :: self
    integer :: i
    do i = 1, size(self%nu)
      if (self%outcome(i) /= outcome_converged) cycle
      if (all(ieee_is_finite(real(self%coefficients(:, :, i)))) .and. &
          all(ieee_is_finite(aimag(self%coefficients(:, :, i)))) .and. &
          ieee_is_finite(self%truncation(i))) cycle
      call self%discard(i, outcome_overflow)
    end do
  end subroutine keep_finite

  !> Extend to all coordinates; those that were not computed are 0.
  subroutine spread_out(self, moved)
    class(response_type), intent(inout) :: self
    !> True for computed coordinates, shape (n_dof).
    logical, intent(in) :: moved(:)
    complex(wp), allocatable :: all_of_them(:, :, :), history(:, :, :, :)
    integer :: d, n

    allocate (all_of_them(size(self%orders), size(moved), size(self%nu)), source=(0.0_wp, 0.0_wp))
    n = 0
    do d = 1, size(moved)
      if (.not. moved(d)) cycle
      n = n + 1
      all_of_them(:, d, :) = self%coefficients(:, n, :)
    end do
    call move_alloc(all_of_them, self%coefficients)
    if (allocated(self%iterates)) then
      allocate (history(size(self%orders), size(moved), size(self%iterates, 3), size(self%nu)), &
                source=(0.0_wp, 0.0_wp))
      n = 0
      do d = 1, size(moved)
        if (moved(d)) n = n + 1
        if (moved(d)) history(:, d, :, :) = self%iterates(:, n, :, :)
      end do
      call move_alloc(history, self%iterates)
    end if
    ! NaN where no solution was found.
    do n = 1, size(self%nu)
      if (self%outcome(n) /= outcome_converged) call self%discard(n, self%outcome(n))
    end do
  end subroutine spread_out

end module viscovib_response
