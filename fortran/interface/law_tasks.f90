!> Tasks about force laws as programs, and about hysteresis elements.
module viscovib_law_tasks
  use viscovib_binding_tools, only: read_formulas
  use viscovib_frequency_law, only: frequency_law
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis, state_user
  use viscovib_hysteresis_loop, only: run_loop
  use viscovib_kinds, only: i8, wp
  use viscovib_law_program, only: law_program, wall
  use viscovib_law_term, only: about_rest, law_term
  use viscovib_law_text, only: compile_law
  use viscovib_polynomial_text, only: expand, terms_type
  use viscovib_status, only: fail, status_input_error
  use viscovib_task, only: task_type
  use viscovib_user_elements, only: n_user_elements, user_element, user_element_fault, &
    user_element_is_odd
  implicit none
  private

  public :: law_task

  !> Largest length of the name of an argument or parameter; length of a field in a text of names.
  integer, parameter :: longest_name = 64
  !> Largest number of instructions.
  integer, parameter :: max_code = 2000
  !> Comparisons of monomials in the expansion of a polynomial.
  integer, parameter :: most_compared = 10000000

contains

  subroutine law_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('values')
      call find_values(task)
    case ('of_frequency')
      call find_frequency_values(task)
    case ('compile')
      call compile_once(task)
    case ('expand')
      call expand_text(task)
    case ('fault')
      call find_fault(task)
    case ('compile_many')
      call compile_many(task)
    case ('loops')
      call find_loops(task)
    case ('stiffness_at_rest')
      call find_stiffness(task)
    case ('user_elements')
      call list_user_elements(task)
    case ('check_user_element')
      call check_user_element(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine law_task

  !> Values of a program, `code` and `number` (m) of each instruction, at `arguments`
  !! (n, n_arguments); `with_slopes`: also derivatives, which take most of the time.
  subroutine find_values(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: arguments(:, :)
    real(wp), allocatable :: values(:), slopes(:, :)
    type(law_program) :: law

    call read_program(task, law)
    arguments => task%get_matrix('arguments')
    if (task%failed()) return
    law%n_arguments = size(arguments, 2)
    call law%measure()
    allocate (values(size(arguments, 1)))
    if (task%get_flag('with_slopes')) then
      allocate (slopes(size(arguments, 1), size(arguments, 2)))
      call law%differentiate(arguments, values, slopes)
      call task%found%put_reals('slopes', slopes, shape(slopes))
    else
      call law%evaluate(arguments, values)
    end if
    call task%found%put_reals('values', values, shape(values))
  end subroutine find_values

  subroutine read_program(task, law)
    type(task_type), intent(inout) :: task
    type(law_program), intent(out) :: law
    allocate (law%code, source=task%get_integers('code'))
    allocate (law%number, source=task%get_reals('number'))
    call task%check_extents('number', shape(law%number), shape(law%code))
  end subroutine read_program

  !> Values (n, m) of functions of the frequency, one per line of the `text`, at `nu` (n).
  subroutine find_frequency_values(task)
    type(task_type), intent(inout) :: task
    type(frequency_law), allocatable :: laws(:)
    real(wp), pointer, contiguous :: nu(:)
    real(wp), allocatable :: values(:, :)
    integer :: i, k

    nu => task%get_reals('nu')
    if (task%failed()) return
    call read_formulas(task%get_text('text'), laws, task%status)
    allocate (values(size(nu), size(laws)))
    do k = 1, size(laws)
      do i = 1, size(nu)
        if (.not. task%failed()) call laws(k)%check_at(nu(i), task%status)
        values(i, k) = laws(k)%at(nu(i))
      end do
    end do
    if (task%failed()) return
    call task%found%put_reals('values', values, shape(values))
  end subroutine find_frequency_values

  !> Compile a `text` with the names of its `arguments` and `names` of its parameters, `values`
  !! (n_names): `code` and `number` of each instruction, parity and degree of the law.
  subroutine compile_once(task)
    type(task_type), intent(inout) :: task
    character(len=longest_name), allocatable :: arguments(:), names(:)
    character(len=:), allocatable :: fault
    type(law_program) :: law
    real(wp), pointer, contiguous :: values(:)
    integer :: parity, degree

    allocate (arguments, source=names_in(task%get_text('arguments')))
    allocate (names, source=names_in(task%get_text('names')))
    values => task%get_reals('values')
    call task%check_extents('values', shape(values), shape(names))
    if (task%failed()) return
    call compile_law(task%get_text('text'), arguments, names, values, law, parity, degree, fault)
    if (task%failed()) return
    if (fault /= '') then
      call fail(task%status, status_input_error, 'law', fault)
      return
    end if
    call task%found%put_integers('code', law%code, shape(law%code))
    call task%found%put_reals('number', law%number, shape(law%number))
    call task%found%put_integer('parity', int(parity, i8))
    call task%found%put_integer('degree', int(degree, i8))
  end subroutine compile_once

  !> Expand a polynomial `text` in `names`: `coefficients` (m) and `powers` (n_names, m).
  subroutine expand_text(task)
    type(task_type), intent(inout) :: task
    character(len=longest_name), allocatable :: names(:)
    character(len=:), allocatable :: fault
    type(terms_type) :: terms
    integer :: effort

    allocate (names, source=names_in(task%get_text('names')))
    if (task%failed()) return
    effort = most_compared
    call expand(task%get_text('text'), names, terms, fault, effort)
    if (task%failed()) return
    if (fault /= '') then
      call fail(task%status, status_input_error, 'law', fault)
      return
    end if
    call task%found%put_reals('coefficients', terms%coefficients, shape(terms%coefficients))
    call task%found%put_integers('powers', terms%powers, shape(terms%powers))
  end subroutine expand_text

  !> The `fault` of a program near zero arguments, `n_arguments`, see `about_rest`; '': none.
  subroutine find_fault(task)
    type(task_type), intent(inout) :: task
    character(len=:), allocatable :: fault
    real(wp), allocatable :: slopes(:)
    type(law_term) :: law

    call read_program(task, law%program)
    law%program%n_arguments = task%get_integer('n_arguments')
    if (task%failed()) return
    call law%program%measure()
    allocate (slopes(law%program%n_arguments))
    call about_rest(law, slopes, fault)
    call task%found%put_text('fault', fault)
  end subroutine find_fault

  !> Compile a `text` for `values` (n_names, n) of its parameters: `code` and `number` (n_code, n),
  !! 0 after the `lengths` (n); `slopes` (n_arguments, n) at zero arguments; `flaws` (n): 1 if the
  !! law is invalid with these values, undefined within `near` of 0, or too long.
  subroutine compile_many(task)
    type(task_type), intent(inout) :: task
    character(len=longest_name), allocatable :: arguments(:), names(:)
    character(len=:), allocatable :: text, fault
    real(wp), pointer, contiguous :: values(:, :)
    real(wp), allocatable :: number(:, :), slopes(:, :), at(:, :), value(:), by(:, :)
    integer, allocatable :: code(:, :), lengths(:), flaws(:)
    type(law_program) :: law
    real(wp) :: rest(1), near
    integer :: i, k, m, n, parity, degree, longest

    text = task%get_text('text')
    allocate (arguments, source=names_in(task%get_text('arguments')))
    allocate (names, source=names_in(task%get_text('names')))
    near = task%get_real('near')
    values => task%get_matrix('values')
    n = size(values, 2)
    m = size(arguments)
    call task%check_extents('values', shape(values), [size(names), n])
    if (task%failed()) return
    longest = min(len(text) + 1, max_code)
    allocate (code(longest, n), lengths(n), source=0)
    allocate (number(longest, n), slopes(m, n), at(2*m + 1, m), source=0.0_wp)
    allocate (value(2*m + 1), by(1, m))
    allocate (flaws(n), source=1)
    do i = 1, m
      at(1 + i, i) = near
      at(1 + m + i, i) = -near
    end do
    do i = 1, n
      call compile_law(text, arguments, names, values(:, i), law, parity, degree, fault)
      if (fault /= '') cycle
      k = size(law%code)
      if (k > longest) cycle
      lengths(i) = k
      code(:k, i) = law%code
      number(:k, i) = law%number
      call law%evaluate(at, value)
      call law%differentiate(at(:1, :), rest, by)
      slopes(:, i) = by(1, :)
      if (all(abs(value) < wall) .and. all(abs(by) < wall)) flaws(i) = 0
    end do
    call task%found%put_integers('code', code, shape(code))
    call task%found%put_reals('number', number, shape(number))
    call task%found%put_integers('lengths', lengths, shape(lengths))
    call task%found%put_reals('slopes', slopes, shape(slopes))
    call task%found%put_integers('flaws', flaws, shape(flaws))
  end subroutine compile_many

  !> Forces of an element, `state` and `numbers` (m), over cycles of deflections `d` (n, n_cycles),
  !! linear between samples, and the energy lost in each cycle.
  subroutine find_loops(task)
    type(task_type), intent(inout) :: task
    class(hysteresis_type), allocatable :: element
    real(wp), pointer, contiguous :: d(:, :)
    real(wp), allocatable :: force(:, :), lost(:)
    integer :: i

    d => task%get_matrix('d')
    call make_element(task, element)
    if (task%failed()) return
    allocate (force(size(d, 1), size(d, 2)), lost(size(d, 2)))
    do i = 1, size(d, 2)
      call run_loop(element, d(:, i), force(:, i), lost(i))
    end do
    call task%found%put_reals('force', force, shape(force))
    call task%found%put_reals('lost', lost, shape(lost))
  end subroutine find_loops

  !> df/dd of an element, `state` and `numbers` (m), at zero states.
  subroutine find_stiffness(task)
    type(task_type), intent(inout) :: task
    class(hysteresis_type), allocatable :: element

    call make_element(task, element)
    if (task%failed()) return
    call task%found%put_real('stiffness', element%stiffness_at_rest())
  end subroutine find_stiffness

  subroutine make_element(task, element)
    type(task_type), intent(inout) :: task
    class(hysteresis_type), allocatable, intent(out) :: element
    real(wp), pointer, contiguous :: numbers(:)
    integer :: state

    state = task%get_integer('state')
    numbers => task%get_reals('numbers')
    if (.not. task%failed()) call new_hysteresis(element, state, numbers)
  end subroutine make_element

  !> User-defined elements: `states` and `odd` (n), 1 for an odd element; `names`: one line per
  !! element, with its name and the names of its parameters.
  subroutine list_user_elements(task)
    type(task_type), intent(inout) :: task
    integer :: states(n_user_elements), odd(n_user_elements), i
    character(len=:), allocatable :: names

    names = ''
    do i = 1, n_user_elements
      states(i) = state_user + i
      odd(i) = merge(1, 0, user_element_is_odd(i))
      names = names//user_element(i)//new_line('a')
    end do
    call task%found%put_integers('states', states, shape(states))
    call task%found%put_integers('odd', odd, shape(odd))
    call task%found%put_text('names', names)
  end subroutine list_user_elements

  !> Check the parameters `numbers` (m) of a user-defined element, `state`.
  subroutine check_user_element(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: numbers(:)
    character(len=:), allocatable :: fault
    integer :: state

    state = task%get_integer('state')
    numbers => task%get_reals('numbers')
    if (task%failed()) return
    fault = user_element_fault(state - state_user, numbers)
    if (fault /= '') call fail(task%status, status_input_error, 'element', fault)
  end subroutine check_user_element

  !> Split a text with one field per name.
  pure function names_in(text) result(names)
    character(len=*), intent(in) :: text
    character(len=longest_name), allocatable :: names(:)
    integer :: i
    allocate (names(len(text)/longest_name))
    do i = 1, size(names)
      names(i) = text(longest_name*(i - 1) + 1:longest_name*i)
    end do
  end function names_in

end module viscovib_law_tasks
