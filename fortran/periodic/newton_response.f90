! Optimize: -O2 -fvect-cost-model=dynamic
!> The nonlinear steady response by Newton's method at successive frequencies, each from the
!! previous solution. Like a slow sweep, it follows its branch as far as that exists.
module viscovib_newton_response
  use viscovib_balance_ladder, only: balance_ladder_type
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: newton_factors, share_of_motion, weighted_norm
  use viscovib_motion_stability, only: stability_checker, new_stability_checker
  use viscovib_newton_point, only: newton_point, point_from_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged, outcome_singular, outcome_stopped
  use viscovib_point_orders, only: choose_orders, order_choice
  use viscovib_response, only: response_options, response_type
  use viscovib_stopping, only: begin_piece, is_set, stop_wanted
  use viscovib_truncated_stability, only: doubt_motions
  implicit none
  private

  public :: newton_response

  !> Highest order of a search from zero: enough to avoid spurious solutions.
  integer, parameter :: orders_from_rest = 9

  !> State of the response along the frequencies.
  type :: walk_type
    type(order_choice) :: choice
    type(newton_factors) :: factors
    !> The present motion, the last one found and the one before; number of rows that may be
    !! nonzero, and of rows of the present motion.
    real(wp), allocatable :: x(:, :), last(:, :), before(:, :)
    integer :: rows = 0, m = 0
    real(wp) :: last_nu = 0.0_wp, before_nu = 0.0_wp
    !> Number of known motions, and the rung for motions computed from zero.
    integer :: known = 0, rest = 0
    !> True if the last motion is an initial guess from which no motion was reached yet.
    logical :: begins = .false.
    integer :: outcome = outcome_converged
  contains
    procedure :: begin
    procedure :: begin_at
    procedure :: take
    procedure :: find
    procedure :: attempt
    procedure :: add_orders
    procedure :: advance
  end type walk_type

contains

  !> Motions in `found` are kept, and the next motions start from them.
  subroutine newton_response(system, load, nu, ladder, options, response, cancel, start, found)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s).
    real(wp), intent(in) :: nu(:)
    !> Fixed harmonics, or the sets to choose from.
    type(balance_ladder_type), intent(inout) :: ladder
    type(response_options), intent(in) :: options
    !> The response relative to the base.
    type(response_type), intent(out) :: response
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    !> Initial motion, shape (2 n_orders of the highest rung, n_dof).
    real(wp), intent(in), optional :: start(:, :)
    !> Motions computed by another method, relative to the base.
    type(response_type), intent(in), optional :: found
    type(walk_type) :: walk
    integer :: i, m, rest

    rest = ladder%rung_of(orders_from_rest)
    ladder%least = options%least
    call ladder%prepare(rest, system, load, nu(1))
    if (present(found)) then
      response = found
    else
      call response%allocate_for(nu, ladder%rungs(rest)%balance%set%orders, system%n_dof(), 0)
    end if
    call walk%begin(rest, 2*ladder%n_orders(ladder%n_rungs), system%n_dof())
    if (present(start)) call walk%begin_at(start, nu(1), ladder)
    do i = 1, size(nu)
      if (is_set(cancel)) return
      if (present(found)) then
        if (found%outcome(i) == outcome_converged) then
          call walk%take(response, i, ladder)
          cycle
        end if
        call response%renew(i)
      end if
      call begin_piece()
      if (stop_wanted()) then
        call response%discard(i, outcome_stopped)
        cycle
      end if
      call walk%find(system, load, nu(i), ladder, options%tolerance, response%iterations(i), cancel)
      if (walk%outcome /= outcome_converged) then
        call response%discard(i, walk%outcome)
        cycle
      end if
      call keep(walk, ladder, i, response)
      m = min(size(response%orders), size(walk%x, 1)/2)
      associate (x => walk%x(:2*m, :))
        call response%allow(options, i, weighted_norm(system, x) &
                            *share_of_motion(system, load, 1.0_wp, response%orders(:m), x))
      end associate
      call walk%advance(nu(i))
    end do
    if (options%stability) then
      call check_all(system, ladder%rungs(ladder%rung_of(maxval(response%orders)))%balance%set, &
                     response, cancel)
    end if
  end subroutine newton_response

  !> Initialize without a known motion.
  subroutine begin(self, rest, n, n_dof)
    class(walk_type), intent(inout) :: self
    integer, intent(in) :: rest, n, n_dof
    self%rest = rest
    self%choice%rung = rest
    allocate (self%x(n, n_dof), self%last(n, n_dof), self%before(n, n_dof), source=0.0_wp)
  end subroutine begin

  !> Use a given motion as the last one.
  subroutine begin_at(self, start, nu, ladder)
    class(walk_type), intent(inout) :: self
    real(wp), intent(in) :: start(:, :), nu
    type(balance_ladder_type), intent(in) :: ladder
    integer :: last

    last = findloc(sum(abs(start), 2) > 0.0_wp, .true., 1, back=.true.)
    do while (2*ladder%n_orders(self%choice%rung) < last .and. self%choice%rung < ladder%n_rungs)
      self%choice%rung = self%choice%rung + 1
    end do
    self%rest = max(self%rest, self%choice%rung)
    self%rows = 2*ladder%n_orders(self%choice%rung)
    self%last(:self%rows, :) = start(:self%rows, :)
    self%last_nu = nu
    self%known = 1
    self%begins = .true.
  end subroutine begin_at

  !> Use a motion found by another method as the last one; its harmonics above the highest rung are
  !! dropped.
  subroutine take(self, response, i, ladder)
    class(walk_type), intent(inout) :: self
    type(response_type), intent(in) :: response
    integer, intent(in) :: i
    type(balance_ladder_type), intent(in) :: ladder
    integer :: d, k

    k = count(response%orders <= response%highest(i))
    do while (ladder%n_orders(self%choice%rung) < k .and. self%choice%rung < ladder%n_rungs)
      self%choice%rung = self%choice%rung + 1
    end do
    k = min(k, ladder%n_orders(ladder%n_rungs))
    self%m = 2*k
    self%rows = max(self%rows, self%m)
    self%x(:self%rows, :) = 0.0_wp
    do d = 1, size(self%x, 2)
      self%x(1:2*k:2, d) = real(response%coefficients(:k, d, i))
      self%x(2:2*k:2, d) = aimag(response%coefficients(:k, d, i))
    end do
    call self%advance(response%nu(i))
  end subroutine take

  !> Find a motion at a frequency: extrapolated from the last two, from the last, or from zero.
  subroutine find(self, system, load, nu, ladder, tolerance, iterations, cancel)
    class(walk_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, tolerance
    type(balance_ladder_type), intent(inout) :: ladder
    integer, intent(inout) :: iterations
    integer, intent(inout), optional :: cancel

    self%outcome = outcome_singular
    associate (x => self%x(:self%rows, :), last => self%last(:self%rows, :), &
               before => self%before(:self%rows, :))
      if (self%known >= 2) then
        x = last + (last - before)*((nu - self%last_nu)/(self%last_nu - self%before_nu))
        call self%attempt(system, load, nu, ladder, tolerance, iterations, .false.)
      end if
    end associate
    if (self%outcome /= outcome_converged .and. self%known >= 1) then
      self%x(:self%rows, :) = self%last(:self%rows, :)
      call self%attempt(system, load, nu, ladder, tolerance, iterations, .false.)
    end if
    if (self%outcome == outcome_converged .or. self%begins) then
      self%begins = self%begins .and. self%outcome /= outcome_converged
      return
    end if
    self%known = 0
    self%choice%rung = self%rest
    call self%attempt(system, load, nu, ladder, tolerance, iterations, .true., cancel)
    ! Try more orders if adding them failed.
    if (self%outcome /= outcome_converged .and. self%choice%rung > self%rest) then
      call self%attempt(system, load, nu, ladder, tolerance, iterations, .true., cancel)
    end if
  end subroutine find

  !> Newton's method from x, where orders above those of the rung are dropped, or from rest under
  !! an increasing load.
  subroutine attempt(self, system, load, nu, ladder, tolerance, iterations, from_rest, cancel)
    class(walk_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, tolerance
    type(balance_ladder_type), intent(inout) :: ladder
    integer, intent(inout) :: iterations
    logical, intent(in) :: from_rest
    integer, intent(inout), optional :: cancel
    integer :: m

    call ladder%prepare(self%choice%rung, system, load, nu)
    m = 2*ladder%n_orders(self%choice%rung)
    self%m = m
    self%x(merge(0, m, from_rest) + 1:self%rows, :) = 0.0_wp
    associate (balance => ladder%rungs(self%choice%rung)%balance)
      if (from_rest) then
        call point_from_rest(balance, system, load, tolerance, self%x(:m, :), self%outcome, &
                             iterations, cancel, self%factors, least=ladder%least)
      else
        call newton_point(balance, system, tolerance, self%x(:m, :), self%outcome, iterations, &
                          self%factors, least=ladder%least)
      end if
    end associate
    call self%add_orders(system, load, nu, ladder, tolerance, iterations)
  end subroutine attempt

  subroutine add_orders(self, system, load, nu, ladder, tolerance, iterations)
    class(walk_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu, tolerance
    type(balance_ladder_type), intent(inout) :: ladder
    integer, intent(inout) :: iterations

    if (self%outcome /= outcome_converged) return
    call choose_orders(ladder, system, load, nu, tolerance, self%x, self%factors, self%choice, &
                       self%outcome, iterations)
    self%rows = max(self%rows, 2*ladder%n_orders(max(self%choice%solved, self%choice%rung)))
  end subroutine add_orders

  !> Make the motion found the last one.
  subroutine advance(self, nu)
    class(walk_type), intent(inout) :: self
    real(wp), intent(in) :: nu

    ! Equal frequencies give no direction for an extrapolation.
    if (self%known > 0 .and. .not. abs(nu - self%last_nu) > 0.0_wp) self%known = 0
    self%rows = max(self%rows, self%m)
    self%before(:self%rows, :) = self%last(:self%rows, :)
    self%before_nu = self%last_nu
    self%last(:self%rows, :) = self%x(:self%rows, :)
    self%last_nu = nu
    self%known = self%known + 1
  end subroutine advance

  subroutine keep(walk, ladder, i, response)
    type(walk_type), intent(in) :: walk
    type(balance_ladder_type), intent(in) :: ladder
    integer, intent(in) :: i
    type(response_type), intent(inout) :: response
    integer :: d, k

    k = ladder%n_orders(walk%choice%solved)
    if (k > size(response%orders)) then
      call response%widen(ladder%rungs(walk%choice%solved)%balance%set%orders)
    end if
    do d = 1, size(walk%x, 2)
      response%coefficients(:k, d, i) = cmplx(walk%x(1:2*k:2, d), walk%x(2:2*k:2, d), wp)
    end do
    response%highest(i) = ladder%highest(walk%choice%solved)
    response%truncation(i) = walk%choice%truncation
  end subroutine keep

  !> Stability of the motions found, in coordinates relative to the base.
  subroutine check_all(system, set, response, cancel)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(response_type), intent(inout) :: response
    integer, intent(inout), optional :: cancel
    type(stability_checker) :: checker
    real(wp), allocatable :: x(:, :, :)

    allocate (x(2*size(set%orders), system%n_dof(), size(response%nu)))
    x(1::2, :, :) = real(response%coefficients)
    x(2::2, :, :) = aimag(response%coefficients)
    call new_stability_checker(checker, system, set)
    call checker%check(system, response%nu, x, response%stability, cancel)
    call doubt_motions(checker, system, response%nu, x, response%truncation, response%allowed, &
                       response%stability, cancel)
  end subroutine check_all

end module viscovib_newton_response
