!> Perturbations of a motion whose force laws have kinks or states, over a period.
!!
!! With the linear subsystem s' = A_0 s - B f and coordinates y = Y s, a perturbation obeys
!!
!!   s' = A_0 s - B S(t) (Y s, Y A_0 s) - B w z,   z_j' = g_z v z_j + g (d/dt)(e . Y s),
!!
!! For a sum of exponentials each term is a state too: a variable w with memory acts as w - sum_l
!! weight_l m_l, m_l' = w - rate_l m_l.
!!
!! S contains the derivatives of the laws along the motion, z the states of elements with
!! hysteresis. All terms are smooth between the phases at which a law changes its branch. There a
!! continuous law does not change a perturbation. A slider that begins to slide loses its
!! perturbation, z_j = 0, so its multiplier is exactly 0. A slider that always sticks is a spring;
!! its multiplier 1, for a different sticking position, is omitted.
module viscovib_kinked_motion
  use viscovib_compliance, only: compliance_type
  use viscovib_constants, only: pi
  use viscovib_cycle_terms, only: has_kinks
  use viscovib_dense, only: invert
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis
  use viscovib_hysteresis_cycle, only: find_kinks, find_turns
  use viscovib_hysteresis_loop, only: find_start
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: find_signals
  use viscovib_law_cycle, only: find_switches
  use viscovib_law_program, only: law_program
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phase_panels, only: wave_sum
  use viscovib_phase_roots, only: phase_list
  use viscovib_polynomial, only: polynomial_type
  use viscovib_prony, only: prony_kernel
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: element_along, is_kinked, linear_rest, new_rest, prepare_elements

  !> The linear subsystem without the laws, and its outputs.
  type :: linear_rest
    !> A_0 (n, n), B (n, n_dof), Y and Y A_0 (n_dof, n).
    real(wp), allocatable :: a(:, :), b(:, :), y(:, :), rate(:, :)
    !> Index of the variable of each memory state; these are the last states of s.
    integer, allocatable :: remembers(:)
    !> Frequency of the fastest mode (rad/s), which scales rates among the states.
    real(wp) :: fastest = 0.0_wp
  end type linear_rest

  !> One element with hysteresis along the motion.
  type :: element_along
    class(hysteresis_type), allocatable :: element
    integer :: law = 0
    !> Harmonics of its deflection.
    real(wp), allocatable :: d(:)
    !> States and deflection at the present phase; states at the start; states that never slide.
    real(wp), allocatable :: z(:), start(:)
    real(wp) :: at = 0.0_wp
    logical, allocatable :: sticks(:)
  end type element_along

  !> A state whose multiplier differs from 1 by less than this sticks.
  real(wp), parameter :: as_one = 1.0e-6_wp
  !> Largest number of states of the linear subsystem.
  integer, parameter :: most_states = 40

contains

  !> True for systems that this method treats: laws with kinks, jumps or states, without memory or
  !! with sums of decaying exponentials.
  logical function is_kinked(system)
    class(oscillator_type), intent(in) :: system

    is_kinked = .false.
    if (system%moving .or. .not. has_kinks(system)) return
    select type (system)
    class is (polynomial_type)
      is_kinked = fade(system)
    end select
  end function is_kinked

  !> True if all memory is a sum of decaying exponentials.
  logical function fade(system)
    class(oscillator_type), intent(in) :: system
    integer :: j

    fade = .true.
    do j = 1, size(system%kernel_of)
      if (system%kernel_of(j) == 0) cycle
      associate (kernel => system%kernels(system%kernel_of(j))%kernel)
        select type (kernel)
        type is (prony_kernel)
          fade = fade .and. all(kernel%rates > 0.0_wp)
        class default
          fade = .false.
        end select
      end associate
    end do
  end function fade

  !> First-order form of the linear subsystem; `found` is false if it is large or has other terms
  !! than modes.
  subroutine new_rest(rest, system, found)
    type(linear_rest), intent(out) :: rest
    class(oscillator_type), intent(in) :: system
    logical, intent(out) :: found
    complex(wp) :: inverse(size(system%mass, 1), size(system%mass, 1))
    logical :: singular
    integer :: i, m

    select type (system)
    class is (structure_type)
      call take_modes(rest, system%rest, found)
    class default
      m = system%n_dof()
      found = 2*m <= most_states
      if (.not. found) return
      call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
      found = .not. singular
      associate (stiffness => matmul(real(inverse), matmul(system%spread, system%gather)), &
                 damping => matmul(real(inverse), system%damping))
        rest%fastest = max(sqrt(maxval(sum(abs(stiffness), 2))), maxval(sum(abs(damping), 2)), &
                           tiny(1.0_wp))
        allocate (rest%a(2*m, 2*m), rest%b(2*m, m), rest%y(m, 2*m), source=0.0_wp)
        rest%a(m + 1:, :m) = -stiffness/rest%fastest
        rest%a(m + 1:, m + 1:) = -damping
      end associate
      rest%b(m + 1:, :) = real(inverse)/rest%fastest
      do i = 1, m
        rest%a(i, m + i) = rest%fastest
        rest%y(i, i) = 1.0_wp
      end do
    end select
    if (.not. found) return
    rest%rate = matmul(rest%y, rest%a)
    call add_memory(rest, system, found)
  end subroutine new_rest

  !> The same of a structure. A pair of complex modes has two states, Re z and Im z.
  subroutine take_modes(rest, own, found)
    type(linear_rest), intent(inout) :: rest
    type(compliance_type), intent(in) :: own
    logical, intent(out) :: found
    integer :: i, m, n

    m = own%n_modes
    n = 2*m + size(own%poles)
    found = n > 0 .and. n <= most_states .and. .not. any(abs(own%flexibility) > 0.0_wp) &
            .and. .not. any(abs(own%losses(:m)) > 0.0_wp)
    if (.not. found) return
    rest%fastest = max(sqrt(maxval([0.0_wp, abs(own%squares(:m))])), &
                       maxval([tiny(1.0_wp), abs(own%rates(:m)), abs(own%poles)]))
    allocate (rest%a(n, n), rest%b(n, own%n_seen), rest%y(own%n_seen, n), source=0.0_wp)
    do i = 1, m
      rest%a(i, m + i) = rest%fastest
      rest%a(m + i, i) = -own%squares(i)/rest%fastest
      rest%a(m + i, m + i) = -own%rates(i)
      rest%b(m + i, :) = own%pushed(i, :)/rest%fastest
      rest%y(:, i) = own%seen(i, :)
    end do
    n = 2*m
    do i = 1, size(own%poles)
      if (aimag(own%poles(i)) < 0.0_wp) cycle
      n = n + 1
      rest%a(n, n) = real(own%poles(i))
      rest%b(n, :) = real(own%right(i, :))
      rest%y(:, n) = real(own%left(i, :))
      if (.not. aimag(own%poles(i)) > 0.0_wp) cycle
      rest%y(:, n) = 2.0_wp*rest%y(:, n)
      n = n + 1
      rest%a(n, n) = real(own%poles(i))
      rest%a(n - 1, n) = -aimag(own%poles(i))
      rest%a(n, n - 1) = aimag(own%poles(i))
      rest%b(n, :) = aimag(own%right(i, :))
      rest%y(:, n) = -2.0_wp*aimag(own%left(i, :))
    end do
  end subroutine take_modes

  !> Append the exponentials as states.
  subroutine add_memory(rest, system, found)
    type(linear_rest), intent(inout) :: rest
    class(oscillator_type), intent(in) :: system
    !> Set to false if there are too many states.
    logical, intent(inout) :: found
    real(wp), allocatable :: weights(:), rates(:), all_weights(:), all_rates(:), a(:, :)
    integer :: i, j, n, m

    allocate (rest%remembers(0), all_weights(0), all_rates(0))
    do j = 1, size(system%kernel_of)
      if (system%kernel_of(j) == 0) cycle
      call system%kernels(system%kernel_of(j))%exponentials(1.0_wp, 1.0_wp, 1.0_wp, weights, rates)
      rest%remembers = [rest%remembers, spread(j, 1, size(rates))]
      all_weights = [all_weights, weights]
      all_rates = [all_rates, rates]
    end do
    n = size(rest%a, 1)
    m = size(all_rates)
    found = n + m <= most_states
    if (m == 0 .or. .not. found) return
    allocate (a(n + m, n + m), source=0.0_wp)
    a(:n, :n) = rest%a
    do i = 1, m
      associate (remembered => rest%remembers(i))
        a(:n, n + i) = all_weights(i)*matmul(rest%b, system%spread(:, remembered))
        a(n + i, :n) = matmul(system%gather(remembered, :), rest%y)
        a(n + i, n + i) = -all_rates(i)
      end associate
    end do
    call move_alloc(a, rest%a)
    rest%b = transpose(wider(transpose(rest%b), m))
    rest%y = wider(rest%y, m)
    rest%rate = wider(rest%rate, m)
  end subroutine add_memory

  !> Append columns of zeros.
  pure function wider(columns, more) result(whole)
    real(wp), intent(in) :: columns(:, :)
    integer, intent(in) :: more
    real(wp), allocatable :: whole(:, :)
    allocate (whole(size(columns, 1), size(columns, 2) + more), source=0.0_wp)
    whole(:, :size(columns, 2)) = columns
  end function wider

  !> Elements along a motion, and all phases at which a law changes its branch.
  subroutine prepare_elements(system, set, x, mu, elements, breaks)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Harmonics, shape (2 n_orders, n_dof), and frequencies of the orders.
    real(wp), intent(in) :: x(:, :), mu(:)
    type(element_along), allocatable, intent(out) :: elements(:)
    type(phase_list), intent(out) :: breaks
    real(wp), allocatable :: y(:, :), turned(:, :), scan(:, :)
    type(law_program), allocatable :: signals(:)
    type(phase_list) :: found
    integer :: i, j, k, none(0)

    select type (system)
    class is (polynomial_type)
      allocate (elements(count(system%laws%state > 0)))
      k = 0
      do i = 1, size(system%laws)
        associate (law => system%laws(i))
          turned = matmul(x, transpose(law%rates))
          y = turned
          y(1::2, :) = -spread(mu, 2, size(y, 2))*turned(2::2, :)
          y(2::2, :) = spread(mu, 2, size(y, 2))*turned(1::2, :)
          y = y + matmul(x, transpose(law%arguments))
          if (law%state > 0) then
            k = k + 1
            elements(k)%law = i
            elements(k)%d = y(:, 1)
            call new_hysteresis(elements(k)%element, law%state, law%program%number(2:))
            call start_element(elements(k), set, breaks)
          else
            call find_signals(law%program, none, signals)
            if (size(signals) == 0) cycle
            scan = matmul(transpose(set%synthesis), y)
            call find_switches(signals, set, y, scan, found)
            do j = 1, found%n
              call breaks%put(found%theta(j), 0)
            end do
          end if
        end associate
      end do
    end select
    if (.not. allocated(elements)) allocate (elements(0))
  end subroutine prepare_elements

  !> The periodic cycle of an element, its turning points and its kinks.
  subroutine start_element(one, set, breaks)
    type(element_along), intent(inout) :: one
    type(harmonic_set_type), intent(in) :: set
    type(phase_list), intent(inout) :: breaks
    type(phase_list) :: turns, ends
    real(wp), allocatable :: d(:), by_d(:, :), multiplier(:), by_z(:), by_change(:)
    real(wp) :: work, ending, to
    integer :: i, j, n, turn

    turn = merge(-1, 1, set%half_wave)
    ending = merge(pi, 2.0_wp*pi, set%half_wave)
    call find_turns(set, one%d, turns)
    n = turns%n
    d = [(wave_sum(set, one%d, turns%theta(i)), i=1, n)]
    j = one%element%n_states()
    allocate (by_d(j, n), multiplier(j), by_z(j), by_change(j), one%z(j))
    call find_start(one%element, d, turn, one%z, by_d, multiplier)
    one%start = one%z
    one%at = d(1)
    one%sticks = abs(1.0_wp - turn*multiplier) <= as_one
    do i = 1, n
      to = ending
      if (i < n) to = turns%theta(i + 1)
      call find_kinks(one%element, set, one%d, turns%theta(i), to, d(i), one%z, ends)
      call breaks%put(turns%theta(i), 0)
      do j = 1, ends%n
        call breaks%put(ends%theta(j), 0)
      end do
      if (i < n) then
        call one%element%advance(d(i + 1) - d(i), one%z, by_z, by_change, work)
      else
        call one%element%advance(turn*d(1) - d(i), one%z, by_z, by_change, work)
      end if
    end do
    one%z = one%start
  end subroutine start_element

end module viscovib_kinked_motion
