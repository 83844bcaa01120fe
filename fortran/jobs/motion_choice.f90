! Optimize: -O1
!> The equations by which a motion in time is computed, for every system and every interface.
!!
!! Systems whose laws switch (kinks, jumps, states of elements) have equations without memory: their
!! steps end at the switches, and exponentials of kernels are further coordinates. Smooth systems
!! that fit into a vector lane, and rotors whose speed changes, have the same equations. All other
!! oscillators have equations with memory, whose accelerations are polynomials through the nodes of
!! a step. Systems with strong dampers, and those of very many coordinates, have modes that are
!! exact in each step.
module viscovib_motion_choice
  use viscovib_dense, only: factorize, solve
  use viscovib_fitted_memory, only: bound_hidden
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof
  use viscovib_law_program, only: branches, wall
  use viscovib_law_term, only: law_term
  use viscovib_load, only: load_type
  use viscovib_method_catalogue, only: takes_sections, transient_methods
  use viscovib_modal_frame, only: has_frame, modal_frame, most_in_frame, most_with_memory, &
    new_modal_frame
  use viscovib_mount, only: mount_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_condensation, only: condenses, touched
  use viscovib_status, only: clipped, show
  implicit none
  private

  public :: choose_equations, driven_coordinates, fastest_rate, is_on_shaft, motion_wish, &
    switches_in_time

  !> Kinds of equations: those of `polynomial_equations`, `oscillator_equations` and
  !! `structure_equations`.
  integer, parameter, public :: without_memory = 1, with_memory = 2, by_modes = 3

  !> Methods with memory by their nodes per step, and first number of steps per fastest period.
  character(len=*), parameter, public :: hereditary_methods(5) = &
    [character(len=6) :: 'gauss8', 'gauss6', 'gauss4', 'gauss3', 'gauss2']
  integer, parameter, public :: nodes(5) = [8, 6, 4, 3, 2], per_period(5) = [2, 3, 6, 8, 12]
  !> Storage of the past; 'auto': as exponentials if the kernels are such sums.
  character(len=*), parameter, public :: past_names(3) = &
    [character(len=12) :: 'auto', 'exponentials', 'direct']
  integer, parameter, public :: past_auto = 1, keep_exponentials = 2, keep_direct = 3

  !> Largest number of coordinates of a smooth system that is not condensed.
  integer, parameter, public :: most_whole = 64
  !> Smallest number of coordinates of which modes are faster, also per coordinate with forces or
  !! memory (equal times measured with 1 to 16 of them).
  integer, parameter :: fewest_by_modes = 12, each = 2
  !> Ratio of the fastest rate of the linear subsystem to that of its forces above which modes are
  !! faster (equal times measured at 20 to 70), and smallest number of radians of the fastest rate.
  real(wp), parameter :: much_faster = 50.0_wp, many_radians = 3000.0_wp
  !> Smallest squared cosine of two directions that count as parallel.
  real(wp), parameter :: parallel = 1.0_wp - 1.0e-12_wp

  !> Data of a motion on which its equations depend.
  type :: motion_wish
    !> Names as given, 'auto' among them.
    character(len=:), allocatable :: method, memory
    real(wp) :: t_end = 0.0_wp
    !> True if the base moves; True if a displacement before the start is given.
    logical :: moves_base = .false., is_held = .false.
    !> False if modes are not available, for example because the base moves in several directions.
    logical :: may_have_modes = .true.
    !> Start (q_1, v_1, q_2, v_2, ...), and largest loads on the coordinates; not allocated: 0.
    real(wp), allocatable :: initial(:), pushes(:)
  contains
    procedure :: take_load
  end type motion_wish

contains

  !> The kind of equations of a motion.
  subroutine choose_equations(system, wish, kind, lack)
    class(oscillator_type), intent(in) :: system
    type(motion_wish), intent(in) :: wish
    integer, intent(out) :: kind
    !> Reason why steps cannot end at switches; empty: they can.
    character(len=:), allocatable, intent(out) :: lack

    kind = with_memory
    lack = 'is for systems of constant matrices'
    select type (system)
    class is (polynomial_type)
      if (is_on_shaft(system)) then
        kind = without_memory
        lack = ''
        return
      end if
      if (goes_by_modes(system, wish)) then
        kind = by_modes
        return
      end if
      if (switches_in_time(system)) then
        lack = lack_of_sections(system, wish)
        if (lack == '') kind = without_memory
        return
      end if
      lack = 'is for laws that switch'
      if (any(system%kernel_of > 0) .or. system%n_dof() > max_dof) return
      if (wish%moves_base .or. wish%is_held) return
      if (lack_of_method(wish, [character(len=1) ::]) == '') kind = without_memory
    end select
  end subroutine choose_equations

  !> Add the sizes of the loads on the coordinates.
  subroutine take_load(self, load)
    class(motion_wish), intent(inout) :: self
    type(load_type), intent(in) :: load
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
    call load%forces_in_time(breaks, pieces)
    if (.not. allocated(self%pushes)) self%pushes = 0.0_wp*pieces(:, 1, 1)
    self%pushes = self%pushes + sum(abs(load%force), 2) + maxval(abs(pieces(:, 1, :)), 2)
  end subroutine take_load

  !> Coordinates that the load, the start or the past moves, or all.
  pure function driven_coordinates(system, load, initial, held, all_move) result(driven)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Shapes (2 n_dof) and (n_dof).
    real(wp), intent(in) :: initial(:), held(:)
    logical, intent(in) :: all_move
    logical :: driven(size(held))
    driven = abs(held) > 0.0_wp .or. abs(initial(1::2)) > 0.0_wp .or. abs(initial(2::2)) > 0.0_wp &
             .or. all_move
    ! A scene may have no load.
    if (allocated(load%force)) driven = driven .or. load%drives(system)
  end function driven_coordinates

  !> Fastest natural frequency of a mount, or an upper bound of the rates of another oscillator:
  !! the root of the largest row sum of M^-1 K, plus the largest row sum of M^-1 C.
  real(wp) function fastest_rate(system) result(fastest)
    class(oscillator_type), intent(in) :: system
    real(wp) :: omega(2), shapes(2, 2)

    select type (system)
    class is (mount_type)
      call system%natural_modes(omega, shapes)
      fastest = omega(2)
    class default
      fastest = fastest_of(system, system%damping)
    end select
  end function fastest_rate

  !> The same with another damping matrix.
  real(wp) function fastest_of(system, damping) result(fastest)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: damping(:, :)
    real(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: mass, pull, drag
    integer :: pivots(size(system%mass, 1)), k, n
    logical :: singular

    n = size(mass, 1)
    mass = system%mass
    pull = matmul(system%spread, system%gather)
    drag = damping
    call factorize(n, mass, pivots, singular)
    do k = 1, n
      call solve(n, mass, pivots, pull(:, k))
      call solve(n, mass, pivots, drag(:, k))
    end do
    fastest = sqrt(maxval(sum(abs(pull), 2))) + maxval(sum(abs(drag), 2))
  end function fastest_of

  !> True if a law has kinks or jumps, or an element has an internal state.
  pure logical function switches_in_time(system) result(switches)
    class(oscillator_type), intent(in) :: system
    integer :: i
    switches = .false.
    select type (system)
    class is (polynomial_type)
      do i = 1, size(system%laws)
        switches = system%laws(i)%state > 0 .or. any(branches(system%laws(i)%program%code))
        if (switches) return
      end do
    end select
  end function switches_in_time

  !> True if the last coordinate is the angle of a shaft, whose speed changes.
  pure logical function is_on_shaft(system)
    class(oscillator_type), intent(in) :: system
    is_on_shaft = .false.
    select type (system)
    class is (polynomial_type)
      is_on_shaft = allocated(system%shaft)
    end select
  end function is_on_shaft

  !> True if modes are faster: few of many coordinates have forces, or a fast rate of the linear
  !! subsystem, such as that of a strong damper, would require short steps.
  logical function goes_by_modes(system, wish) result(goes)
    type(polynomial_type), intent(in) :: system
    type(motion_wish), intent(in) :: wish
    goes = .false.
    if (.not. wish%may_have_modes .or. allocated(system%space_damping)) return
    if (wish%method /= 'auto' .and. all(hereditary_methods /= wish%method)) return
    associate (n => system%n_dof(), q => count(touched(system)))
      if (n > most_whole) then
        goes = condenses(system, .false.)
        if (goes .and. switches_in_time(system)) goes = lack_of_sections(system, wish) /= ''
      else if (.not. switches_in_time(system)) then
        goes = q > 0 .and. n >= fewest_by_modes + each*q
        if (.not. goes) goes = is_stiff(system, wish)
      end if
    end associate
  end function goes_by_modes

  !> True if the linear subsystem has a rate that is much faster than the motion, in a long run.
  logical function is_stiff(system, wish)
    type(polynomial_type), intent(in) :: system
    type(motion_wish), intent(in) :: wish
    type(modal_frame) :: frame
    real(wp) :: fastest, none(0, size(system%mass, 1)), pace
    logical :: found

    fastest = fastest_of(system, lasting_damping(system, wish))
    is_stiff = fastest*wish%t_end > many_radians
    if (.not. is_stiff) return
    associate (stiffness => matmul(system%spread, system%gather))
      call new_modal_frame(frame, system%mass, system%damping, stiffness, 0, found)
    end associate
    pace = fastest_of(system, 0.0_wp*system%damping)
    if (found) pace = frame%pace(none)
    is_stiff = fastest > much_faster*pace
  end function is_stiff

  !> Damping matrix without the part that laws lose at the speeds of the motion, as dry friction
  !! smoothed by tanh does.
  function lasting_damping(system, wish) result(damping)
    type(polynomial_type), intent(in) :: system
    type(motion_wish), intent(in) :: wish
    real(wp), dimension(size(system%mass, 1), size(system%mass, 1)) :: damping, lost
    real(wp), dimension(size(system%mass, 1)) :: places, speeds
    real(wp) :: values(2), speed, pace
    real(wp), allocatable :: at(:, :)
    integer :: i, j, k

    damping = system%damping
    places = 0.0_wp
    speeds = 0.0_wp
    pace = fastest_of(system, 0.0_wp*damping)
    if (allocated(wish%initial)) then
      places = wish%initial(1::2)
      speeds = abs(wish%initial(2::2)) + pace*maxval(abs(places))
    end if
    if (allocated(wish%pushes)) then
      speeds = speeds + wish%pushes/max(pace, 1.0_wp/wish%t_end) &
               /[(system%mass(i, i), i=1, size(speeds))]
    end if
    do i = 1, size(system%laws)
      associate (law => system%laws(i))
        lost = 0.0_wp
        do k = 1, size(law%rates, 1)
          speed = dot_product(abs(law%rates(k, :)), speeds)
          if (.not. speed > 0.0_wp) cycle
          at = spread(matmul(law%arguments, places), 1, 2)
          at(2, k) = at(2, k) + speed
          call law%program%evaluate(at, values)
          if (any(abs(values) >= wall)) cycle
          do j = 1, size(law%equations)
            associate (row => lost(law%equations(j), :))
              row = row + law%weights(j)*((values(2) - values(1))/speed)*law%rates(k, :)
            end associate
          end do
        end do
        if (sum([(lost(j, j), j=1, size(speeds))]) < 0.0_wp) damping = damping + lost
      end associate
    end do
    do i = 1, size(speeds)
      ! Self-excited coordinates leave this state.
      if (damping(i, i) < 0.0_wp) damping(i, :) = 0.0_wp
    end do
  end function lasting_damping

  !> Reason why the method or the memory is that of other equations; empty: it is not.
  function lack_of_method(wish, methods) result(lack)
    type(motion_wish), intent(in) :: wish
    !> Names of the methods; empty: all but those of equations with memory only.
    character(len=*), intent(in) :: methods(:)
    character(len=:), allocatable :: lack
    logical :: known

    lack = ''
    if (size(methods) > 0) then
      known = wish%method == 'auto' .or. any(methods == wish%method)
    else
      known = all(hereditary_methods /= wish%method) .or. any(transient_methods == wish%method)
    end if
    if (.not. known) then
      lack = 'has the methods auto'
      if (size(methods) == 0) lack = lack//listed(transient_methods)
      lack = lack//listed(methods)
      lack = lack//", got method = '"//clipped(wish%method)//"'"
    else if (all(past_names(:keep_exponentials) /= wish%memory)) then
      lack = "has memory 'auto' or 'exponentials', got memory = '"//clipped(wish%memory)//"'"
    end if
  end function lack_of_method

  !> Names, each after a comma.
  pure function listed(names) result(text)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: text
    integer :: i
    text = ''
    do i = 1, size(names)
      text = text//', '//trim(names(i))
    end do
  end function listed

  !> Reason why the steps of a system that switches cannot end at its switches; empty: they can.
  function lack_of_sections(system, wish) result(lack)
    type(polynomial_type), intent(in) :: system
    type(motion_wish), intent(in) :: wish
    character(len=:), allocatable :: lack
    integer :: i, n, n_hidden
    logical :: remembers

    n = system%n_dof()
    remembers = any(system%kernel_of > 0)
    if (remembers) then
      lack = lack_of_method(wish, transient_methods(:1))
    else if (n > max_dof) then
      lack = lack_of_method(wish, pack(transient_methods, &
                                       [(takes_sections(i), i=1, size(transient_methods))]))
    else
      lack = lack_of_method(wish, [character(len=1) ::])
    end if
    if (lack /= '' .or. .not. (remembers .or. n > max_dof)) return
    if (remembers) then
      n_hidden = bound_hidden(system)
      if (n_hidden < 0) then
        lack = 'needs kernels that can be replaced by sums of exponentials: use ' &
               //'kernel.sum_of_exponentials(), or the steady motions of forced_response and ' &
               //'trace_response'
      else if (n + n_hidden > most_with_memory) then
        lack = 'is for at most '//show(most_with_memory)//' coordinates and exponentials of ' &
               //'forces that remember, has '//show(n)//' and up to '//show(n_hidden)
      end if
    end if
    if (lack /= '') return
    if (n > most_in_frame) then
      lack = 'is for at most '//show(most_in_frame)//' coordinates, has '//show(n)
    else if (n > max_dof .and. .not. has_frame(system%mass)) then
      lack = 'needs a mass matrix that is symmetric and positive definite'
    else if (shares_switches(system%laws)) then
      lack = 'of more than '//show(max_dof)//' coordinates, or with kernels, takes no law that ' &
             //'switches with the rate, as sign(v), on the deflection of an element with a state'
    end if
  end function lack_of_sections

  !> True if a law that switches with a rate and an element with a state read the same deflection.
  !! Both switch where the deflection reverses, so errors are not a power of the step size.
  pure logical function shares_switches(laws) result(shares)
    type(law_term), intent(in) :: laws(:)
    integer :: i, j, k

    shares = .false.
    do i = 1, size(laws)
      if (laws(i)%state == 0) cycle
      associate (a => laws(i)%arguments(1, :))
        do j = 1, size(laws)
          if (laws(j)%state > 0 .or. .not. any(branches(laws(j)%program%code))) cycle
          do k = 1, size(laws(j)%rates, 1)
            associate (b => laws(j)%rates(k, :))
              if (.not. any(abs(b) > 0.0_wp)) cycle
              shares = dot_product(a, b)**2 >= parallel*dot_product(a, a)*dot_product(b, b)
              if (shares) return
            end associate
          end do
        end do
      end associate
    end do
  end function shares_switches

end module viscovib_motion_choice
