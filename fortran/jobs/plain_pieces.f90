! Optimize: -O1
!> Equations of motion without memory, or with memory by exponentials that are coordinates.
module viscovib_plain_pieces
  use viscovib_driven_system, only: driven_system_type
  use viscovib_fitted_memory, only: copy_system
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_gauss_points, only: points_32, weights_32
  use viscovib_hidden_memory, only: list_hidden
  use viscovib_kernel, only: vanished
  use viscovib_kinds, only: wp
  use viscovib_known_past, only: known_past_type, new_known_past
  use viscovib_lanes, only: max_dof
  use viscovib_load, only: load_type
  use viscovib_memory_channels, only: channels_type, variables_of
  use viscovib_method_catalogue, only: method_order, new_stepper
  use viscovib_motion_piece, only: as_before, check_memory, from_start, motion_equations, &
    not_of_state, of_contact, of_state, of_switch, piece_type, under_other_loads
  use viscovib_pendulum, only: new_pendulum, pendulum_type
  use viscovib_pendulum_spring, only: new_spring, spring_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_reduction, only: reduce
  use viscovib_simulate, only: simulate
  use viscovib_status, only: set_ok, status_type, fail, status_input_error
  use viscovib_stepper, only: stepper_type
  use viscovib_trajectory, only: shaken
  use viscovib_watch, only: new_watch, renumbered
  implicit none
  private

  public :: pendulum_equations, plain_equations, polynomial_equations

  !> All numbers of a shaken pendulum are changed, each differently: the effect is as large as the
  !! factor in `grown_of`.
  real(wp), parameter, public :: part_of_numbers = shaken/8.0_wp

  !> Smallest order of methods for smooth motions.
  integer, parameter :: high_order = 8

  !> Common data of both kinds of equations.
  type, abstract, extends(motion_equations) :: plain_equations
    !> Index in `transient_methods`.
    integer :: method = 1
  contains
    procedure(smooth_interface), deferred :: are_smooth
    procedure(rates_interface), deferred :: find_rates
  end type plain_equations

  abstract interface

    !> True if the equations are analytic and the method has a high order.
    pure logical function smooth_interface(self)
      import :: plain_equations
      class(plain_equations), intent(in) :: self
    end function smooth_interface

    !> The equations for steps h, if they are smooth.
    subroutine rates_interface(self, h, rates, status)
      import :: driven_system_type, plain_equations, status_type, wp
      class(plain_equations), intent(in) :: self
      real(wp), intent(in) :: h
      class(driven_system_type), allocatable, intent(out) :: rates
      type(status_type), intent(out) :: status
    end subroutine rates_interface

  end interface

  !> Equations of a pendulum.
  type, extends(plain_equations) :: pendulum_equations
    type(pendulum_type), pointer :: system => null()
    !> False: the spring only, phi = psi = 0.
    logical :: swings = .true.
  contains
    procedure :: run => run_pendulum
    procedure :: are_smooth => pendulum_is_smooth
    procedure :: find_rates => rates_of_pendulum
    procedure :: move_all => swing_all
  end type pendulum_equations

  !> Equations of a polynomial system without memory, or with memory by exponentials.
  type, extends(plain_equations) :: polynomial_equations
    type(polynomial_type), pointer :: system => null()
    !> Periodic load and its frequency (rad/s).
    type(load_type) :: load
    real(wp) :: nu = 0.0_wp
    !> Latest time of any run that continues, for which kernels are fitted.
    real(wp) :: reach = 0.0_wp
  contains
    procedure :: run => run_polynomial
    procedure :: are_smooth => polynomial_is_smooth
    procedure :: find_rates => rates_of_polynomial
  end type polynomial_equations

contains

  !> A piece of a run of a pendulum.
  subroutine run_pendulum(self, piece, status)
    class(pendulum_equations), intent(in) :: self
    type(piece_type), intent(inout) :: piece
    type(status_type), intent(out) :: status
    type(pendulum_type), pointer :: system
    type(pendulum_type), target :: other
    type(spring_type) :: spring
    class(stepper_type), allocatable :: stepper
    real(wp), pointer, contiguous :: initial(:)
    integer :: n

    call set_ok(status)
    system => self%system
    initial => piece%initial
    if (piece%sign /= 0) then
      call new_pendulum(other, system%parameters%shaken(self%change), status)
      if (status%failed()) return
      system => other
    end if
    if (self%swings) then
      call new_stepper(stepper, system, self%method, initial(1::2), initial(2::2), &
                       piece%first*piece%h, piece%h, piece%tolerance)
    else
      call new_spring(spring, system)
      call new_stepper(stepper, spring, self%method, initial(1:1), initial(2:2), &
                       piece%first*piece%h, piece%h, piece%tolerance)
    end if
    if (piece%resume == as_before) then
      call check_memory(piece, stepper%memory_size(), status)
      if (status%failed()) return
      call stepper%load_memory(piece%memory(:stepper%memory_size()))
    end if
    if (self%swings) then
      if (piece%is_watched) then
        allocate (piece%watch)
        call new_watch(piece%watch, piece%watched, piece%sides)
      end if
      call simulate(stepper, system, piece)
    else
      piece%dofs = [1]
      call simulate(stepper, spring, piece)
    end if
    n = size(stepper%q)
    piece%last(1:2*n:2) = stepper%q
    piece%last(2:2*n:2) = stepper%v
    piece%kept = stepper%save_memory()
    if (piece%marks) piece%kinds = kinds_of(stepper)
    piece%counted = stepper%n_evaluations
  end subroutine run_pendulum

  !> Kinds of the numbers in the memory of a method: only its state grows with a perturbation.
  function kinds_of(stepper) result(kinds)
    class(stepper_type), intent(in) :: stepper
    integer :: kinds(stepper%memory_size())
    kinds = not_of_state
    kinds(:stepper%n_of_state()) = of_state
  end function kinds_of

  subroutine swing_all(self)
    class(pendulum_equations), intent(inout) :: self
    self%swings = .true.
  end subroutine swing_all

  pure logical function pendulum_is_smooth(self) result(smooth)
    class(pendulum_equations), intent(in) :: self
    smooth = method_order(self%method) >= high_order
  end function pendulum_is_smooth

  subroutine rates_of_pendulum(self, h, rates, status)
    class(pendulum_equations), intent(in) :: self
    real(wp), intent(in) :: h
    class(driven_system_type), allocatable, intent(out) :: rates
    type(status_type), intent(out) :: status
    call set_ok(status)
    allocate (rates, source=self%system)
    rates%step_length = h
  end subroutine rates_of_pendulum

  !> False for laws that are no polynomials and for tables, which may have kinks, and for many
  !! coordinates, of which some may be stiff.
  pure logical function polynomial_is_smooth(self) result(smooth)
    class(polynomial_equations), intent(in) :: self
    smooth = method_order(self%method) >= high_order .and. size(self%system%laws) == 0 &
             .and. .not. any(self%system%kernel_of > 0) .and. size(self%breaks) < 2 &
             .and. size(self%base_breaks) < 2 .and. .not. associated(self%turning) &
             .and. self%system%n_dof() <= max_dof
  end function polynomial_is_smooth

  subroutine rates_of_polynomial(self, h, rates, status)
    class(polynomial_equations), intent(in) :: self
    real(wp), intent(in) :: h
    class(driven_system_type), allocatable, intent(out) :: rates
    type(status_type), intent(out) :: status
    type(polynomial_motion_type), allocatable :: motion
    allocate (motion)
    call new_fitted_motion(motion, self%system, self%load, self%nu, h, self%reach, status)
    call move_alloc(motion, rates)
  end subroutine rates_of_polynomial

  !> A piece of a run of a polynomial system. The last numbers of `memory`: largest length of the
  !! next part of a step, whether steps were made in parts, and length of the method's memory.
  subroutine run_polynomial(self, piece, status)
    class(polynomial_equations), intent(in) :: self
    type(piece_type), intent(inout) :: piece
    type(status_type), intent(out) :: status
    type(polynomial_type) :: reduced, taken
    type(polynomial_motion_type) :: motion
    type(load_type) :: part
    class(stepper_type), allocatable :: stepper
    real(wp), allocatable :: q(:), v(:)
    real(wp), pointer, contiguous :: initial(:), memory(:)
    logical, allocatable :: moves(:)
    integer, allocatable :: dofs(:)
    real(wp) :: start
    integer :: i, n, n_all

    n_all = self%system%n_dof()
    initial => piece%initial
    moves = self%moves .or. piece%is_watched .or. piece%accelerates
    dofs = pack([(i, i=1, n_all)], moves)
    n = size(dofs)
    if (n == n_all) then
      call copy_system(self%system, reduced)
      part = self%load
    else
      call reduce(self%system, moves, reduced)
      call self%load%take_part(moves, part)
    end if
    ! With the changed start, forces have changed arguments, u/(1 + s), and values, by 1 + 2 s.
    if (piece%sign /= 0) reduced%mass = reduced%mass*(1.0_wp - 2.0_wp*shaken)
    call new_fitted_motion(motion, reduced, part, self%nu, piece%h, self%reach, status, taken)
    if (status%failed()) return
    call begin_hidden(motion, reduced, taken, self%held(dofs), self%before, self%moved(dofs, :), &
                      status)
    if (status%failed()) return
    call add_tables(self, motion, reduced, dofs)
    motion%thin = piece%thin
    motion%in_parts = motion%layers%exist() .and. piece%in_parts
    start = piece%mesh%start_of(piece%first)
    i = piece%mesh%piece_of(piece%first)
    call motion%base_motion%enter(piece%mesh%beginning(i), piece%mesh%ends(i))
    allocate (q(motion%n_dof), v(motion%n_dof))
    call motion%start(start, initial(2*dofs - 1), initial(2*dofs), q, v)
    if (piece%resume /= from_start) then
      call check_memory(piece, 2*motion%n_dof + motion%n_switches() + 3, status)
      if (status%failed()) return
      memory => piece%memory
    end if
    if (piece%resume == under_other_loads) then
      ! The memory continues: all coordinates, then all velocities.
      q(n + 1:) = memory(n + 1:motion%n_dof)
      v(n + 1:) = memory(motion%n_dof + n + 1:2*motion%n_dof)
    end if
    call new_stepper(stepper, motion, self%method, q, v, start, piece%mesh%h(i), &
                     piece%tolerance)
    if (piece%resume /= from_start) then
      call go_on(piece, motion, stepper, start, maxval(abs(initial)), status)
      if (status%failed()) return
    end if
    if (n < n_all) piece%dofs = dofs
    if (piece%is_watched) then
      ! With events all coordinates are computed.
      allocate (piece%watch)
      call new_watch(piece%watch, renumbered(piece%watched, n, [(i, i=1, motion%n_dof)]), &
                     piece%sides)
    end if
    if (piece%accelerates) then
      allocate (piece%accelerations(n + motion%n_laws(), size(piece%times)), source=0.0_wp)
    end if
    call simulate(stepper, motion, piece)
    i = stepper%memory_size()
    piece%kept = [stepper%save_memory(), motion%keep_switches(), motion%grade, &
                  merge(1.0_wp, 0.0_wp, motion%in_parts), real(i, wp)]
    if (piece%marks) then
      piece%kinds = [kinds_of(stepper), spread(of_switch, 1, motion%n_switches()), &
                     spread(not_of_state, 1, 3)]
      piece%kinds(i + 1:i + motion%n_contacts()) = of_contact
    end if
    piece%in_parts = motion%in_parts
    q = stepper%q
    v = stepper%v
    call motion%add_base(piece%t_reached, q, v)
    piece%last = initial
    piece%last(2*dofs - 1) = q(:n)
    piece%last(2*dofs) = v(:n)
    piece%counted = stepper%n_evaluations
  end subroutine run_polynomial

  !> Restore the data of the previous piece: the method, or with other loads the elements' memory.
  subroutine go_on(piece, motion, stepper, start, largest, status)
    type(piece_type), intent(in) :: piece
    type(polynomial_motion_type), intent(inout) :: motion
    class(stepper_type), intent(inout) :: stepper
    real(wp), intent(in) :: start
    !> Largest number of the state at the start.
    real(wp), intent(in) :: largest
    type(status_type), intent(out) :: status
    real(wp), dimension(motion%n_dof) :: q, v
    integer :: i, n

    call set_ok(status)
    associate (memory => piece%memory)
      if (piece%resume /= under_other_loads) then
        call check_memory(piece, stepper%memory_size() + motion%n_switches() + 3, status)
        if (status%failed()) return
        call stepper%load_memory(memory(:stepper%memory_size()))
      end if
      ! After the data of the method under the previous loads, whose number may differ.
      n = size(memory)
      i = nint(memory(n))
      if (i < 0 .or. i + motion%n_switches() > n - 3) then
        call check_memory(piece, n + 1, status)
        return
      end if
      call motion%recall_switches(memory(i + 1:i + motion%n_switches()))
      motion%begins = piece%resume == under_other_loads
      motion%grade = memory(n - 2)
      if (.not. (motion%begins .and. allocated(motion%sides))) return
      ! The base may continue with a different velocity.
      i = merge(max_dof, motion%n_dof, stepper%explicit)
      q = stepper%q
      v = stepper%v
      call motion%jump_on(start, q, memory(i + 1:i + motion%n_dof), largest, v)
      if (any(abs(v - stepper%v) > 0.0_wp)) call stepper%put(q, v)
    end associate
  end subroutine go_on

  !> Cubics of the load and of the base.
  subroutine add_tables(self, motion, reduced, dofs)
    class(polynomial_equations), intent(in) :: self
    type(polynomial_motion_type), intent(inout) :: motion
    type(polynomial_type), intent(in) :: reduced
    integer, intent(in) :: dofs(:)

    if (size(self%breaks) > 1) call motion%add_table(self%breaks, self%pieces(dofs, :, :))
    if (size(self%base_breaks) < 2) return
    if (size(self%base_pieces, 2) > 1) then
      call motion%base_motion%add_polynomials(size(dofs), [real(wp) ::], self%base_breaks, &
                                              self%base_pieces(:, dofs, :))
    else
      call motion%base_motion%add_polynomials(size(dofs), reduced%base_direction, &
                                              self%base_breaks, self%base_pieces)
    end if
  end subroutine add_tables

  ! Initial state of the hidden masses that represent memory, for a motion with a known past.
  !
  ! Let g_h be the variable held for all t < 0, or before the first of known times. The difference
  ! g - g_h has a beginning:
  !
  !   R*g = I g_h + R*(g - g_h),   I = integral_0^inf R dt,
  !
  ! so that a sum of exponentials must represent R only for the time of a run: the force I g_h is
  ! a constant load, each mass (viscovib_hidden_memory) is dragged by g - g_h, and begins with
  !
  !   m z' = integral_(-inf)^0 exp(r s) (g - g_h) ds.

  !> Initialize a motion with its past.
  subroutine begin_hidden(motion, system, fitted, held, before, moved, status)
    type(polynomial_motion_type), intent(inout) :: motion
    !> With its own kernels, and with the kernels of the motion.
    type(polynomial_type), intent(in) :: system, fitted
    !> As in `past_request`.
    real(wp), intent(in) :: held(:), before(:), moved(:, :)
    type(status_type), intent(out) :: status
    type(channels_type) :: channels
    type(known_past_type) :: past
    integer, allocatable :: variables(:)
    real(wp), allocatable :: rates(:), masses(:)
    real(wp) :: force(motion%n_dof)
    integer :: i, j, n

    call set_ok(status)
    if (motion%n_hidden == 0) return
    n = system%n_dof()
    if (any(abs(held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      call fail(status, status_input_error, 'held', 'held: must be 0, because a kernel has no ' &
                //'finite integral: a deflection held for all t < 0 has no force')
      return
    end if
    call list_hidden(fitted, variables, rates, masses)
    channels%kernel_of = system%kernel_of
    channels%gather = spread(0.0_wp*system%kernel_of, 2, size(system%kernel_of))
    do j = 1, size(system%kernel_of)
      channels%gather(j, j) = 1.0_wp
    end do
    channels%held = 0.0_wp*system%kernel_of
    if (any(abs(held) > 0.0_wp)) then
      channels%held = variables_of(system, held)
      force = 0.0_wp
      do j = 1, size(system%kernel_of)
        if (system%kernel_of(j) == 0) cycle
        force(:n) = force(:n) + system%spread(:, j) &
                    *(system%kernels(system%kernel_of(j))%integral()*channels%held(j))
      end do
      force(n + 1:) = -channels%held(variables)
      call motion%hold(force)
    end if
    if (size(before) < 2) return
    call new_known_past(past, system, channels, before, moved)
    motion%hidden_speeds = [(dragged(past, variables(i), rates(i))/masses(i), i=1, size(rates))]
  end subroutine begin_hidden

  !> integral exp(r s) (g - g_h) ds over the times of a past.
  real(wp) function dragged(past, variable, rate)
    type(known_past_type), intent(in) :: past
    integer, intent(in) :: variable
    real(wp), intent(in) :: rate
    real(wp) :: length, part, s
    integer :: i, k

    dragged = 0.0_wp
    do i = size(past%g, 3), 1, -1
      if (-rate*past%times(i) > vanished) exit
      length = past%times(i) - past%times(i - 1)
      part = length
      if (rate*length > vanished) part = vanished/rate
      do k = 1, size(points_32)
        s = past%times(i) - part*points_32(k)
        dragged = dragged + part*weights_32(k)*exp(rate*s) &
                  *dot_product(past%table%basis((s - past%times(i - 1))/length), &
                               past%g(:, variable, i))
      end do
    end do
  end function dragged

end module viscovib_plain_pieces
